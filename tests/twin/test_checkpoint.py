"""Saved twins: fields by name, the same bits after a load, and no harm from damaged files."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
import math
import os
import shutil
import subprocess
import sys
import warnings
import zipfile
from collections import deque
from pathlib import Path

import numpy as np
import pytest

import twin
from twin import Prediction, Predictor, StateError, Twin, files
from twin.checkpoint import VERSION, record_views
from twin.files import ARCHIVE_MAX
from twin.identification.filter_settings import plain_settings
from twin.logs.log import Log
from twin.predictors.baselines import Persistence
from twin.predictors.ukf import UKFPredictor
from usv_gym import SeaState, Vessel

STOPS = (0, 7, 430, 533, 650)
"""Rows after which a run is interrupted: never started; before the first fix; while the GPS is
lost; in the middle of a window, while the IMU is lost; after the losses."""
END = 750


@pytest.fixture(scope="module")
def losses(zigzag) -> Log:
    """The zigzag with no fix in the first 0.5 s, without GPS from 20 to 25 s, then without IMU."""
    z = zigzag.z.copy()
    z[:10, :2] = math.nan
    z[400:500, :4] = math.nan
    z[520:620, 5:8] = math.nan
    return dataclasses.replace(zigzag, z=z)


def feed(twin, log, first, last):
    for k in range(first, last):
        twin.step(log.t[k], log.z[k], log.cmd[k])


def answers(twin):
    """Everything that a twin can be asked."""
    now, ahead = twin.estimate(), twin.predict("hold", dt=0.1)
    return [
        *(now.t, now.state, now.sd, now.params, now.params_sd, now.ready),
        *(getattr(ahead, item.name) for item in dataclasses.fields(ahead)),
        *(twin.t, twin.cmd),
    ]


def same(one, other):
    for a, b in zip(answers(one), answers(other), strict=True):
        np.testing.assert_array_equal(a, b)


def test_restored_twin_gives_the_same_bits(name, make_twin, losses, tmp_path):
    whole, row = make_twin(name), 0
    for stop in STOPS:
        feed(whole, losses, row, stop)
        whole.save(tmp_path / f"{stop}.twin")
        row = stop
    feed(whole, losses, row, END)
    for stop in STOPS:
        twin = Twin.load(tmp_path / f"{stop}.twin")
        assert type(twin.predictor) is type(whole.predictor)
        feed(twin, losses, stop, END)
        same(whole, twin)


def test_loaded_and_copied_twins_answer_equally(name, make_twin, losses, tmp_path):
    """So does a copy, a second save, and a reset."""
    twin = make_twin(name)
    feed(twin, losses, 0, 450)
    twin.save(tmp_path / "a")
    once = Twin.load(tmp_path / "a")
    once.save(tmp_path / "b")
    same(twin, once)
    twice = Twin.load(tmp_path / "b")
    same(twin, twice)
    same(twin, copy.deepcopy(twin))
    once.reset()
    fresh = make_twin(name)
    same(fresh, once)


def test_more_than_a_saved_twin_holds_is_refused_before_it_is_unpacked(boat, tmp_path):
    path = tmp_path / "boat.twin"
    Twin(boat, "persistence").save(path)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("state.more.npy", bytes(ARCHIVE_MAX + 1))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(StateError, match="more or other than a saved twin has"):
        Twin.load(path)


def test_a_long_history_is_no_reason_to_refuse_a_saved_twin(boat, losses, tmp_path, monkeypatch):
    path = tmp_path / "boat.twin"
    saved = Twin(boat, "persistence")
    saved.run(losses)
    saved.save(path)
    monkeypatch.setattr(files, "ARCHIVE_MAX", 1000)
    with zipfile.ZipFile(path) as archive:
        assert sum(info.file_size for info in archive.infolist()) > 1000
    np.testing.assert_array_equal(Twin.load(path).predict().mean, saved.predict().mean)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("dsw-ukf", {"adapt": "literal", "window": "fixed"}),
        ("dsw-ukf", {"adapt": "signed", "p0": np.full(31, 0.5)}),
        ("dsw-ukf-plus", {"model": "mmg", "period": 2.0}),
        ("ukf", {"model": "mmg"}),
    ],
)
def test_options_are_restored(boat, losses, tmp_path, name, options):
    twin = Twin(boat, name, **options)
    feed(twin, losses, 0, 300)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    np.testing.assert_equal(again.options, options)
    for one in (twin, again):
        feed(one, losses, 300, 500)
    same(twin, again)


@pytest.mark.parametrize("design", ["", "usv75"])
def test_design_is_restored(boat, losses, tmp_path, design):
    twin = Twin(dataclasses.replace(boat, design=design))
    feed(twin, losses, 0, 200)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    assert again.particulars.design == design
    assert again.predictor.particulars == twin.particulars
    for one in (twin, again):
        feed(one, losses, 200, 400)
    same(twin, again)


def test_filter_settings_are_restored(boat, losses, tmp_path):
    twin = Twin(boat, "ukf", settings=dataclasses.replace(plain_settings(boat), alpha=0.5))
    feed(twin, losses, 0, 100)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    assert again.options["settings"].alpha == 0.5
    same(twin, again)


class Drawing(Persistence):
    """A predictor from outside the package, which draws random numbers."""

    def reset(self):
        super().reset()
        self.rng = np.random.default_rng(self.seed)
        self.noise = 0.0

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        self.noise = self.rng.normal()


def test_predictor_given_as_object_is_restored(boat, losses, tmp_path):
    twin = Twin(boat, Drawing(boat, seed=5))
    feed(twin, losses, 0, 300)
    twin.save(tmp_path / "a")
    with pytest.raises(StateError, match=r"Twin\.load\(path, predictor=\.\.\.\)"):
        Twin.load(tmp_path / "a")
    with pytest.raises(StateError, match="holds a Drawing, not a UKFPredictor"):
        Twin.load(tmp_path / "a", UKFPredictor(boat))
    again = Twin.load(tmp_path / "a", Drawing(boat))
    for one in (twin, again):
        feed(one, losses, 300, 400)
    assert twin.predictor.noise == again.predictor.noise
    same(twin, again)


class Everything(Predictor):
    """One attribute of each kind that is saved."""

    constants = ("table",)

    def __init__(self, particulars, *, seed=0, settings=None):
        super().__init__(particulars, seed=seed)
        self.settings = settings
        self.table = {"never": "changes"}
        self.solve = np.linalg.solve
        self.reset()

    def reset(self):
        self.x, self.mask, self.count = np.zeros(3), np.array([True, False]), 0
        self.name, self.fitted, self.error = "start", None, math.nan
        self.numbers, self._rows = [], deque(maxlen=3)
        self.rng = np.random.default_rng(self.seed)
        self.single = np.float64(0.5)

    def update(self, t, dt, z, cmd):
        self.x, self.count, self.name = self.x + t, self.count + 1, "running"
        self.fitted = np.eye(2) * t
        self.numbers.append(self.count)
        self._rows.append(np.array([t, dt]))
        self.error = self.rng.normal()

    @property
    def state(self):
        return np.zeros(6)

    def estimate(self):
        return twin.Estimate(0.0, self.state, self.state, np.zeros(0), np.zeros(0), False)

    def predict(self, plan, dt):
        K = len(plan)
        cov = np.tile(np.eye(6), (K, 1, 1))
        return Prediction(0.0, self.state, cov[0], dt * np.arange(1, K + 1), np.zeros((K, 6)), cov)


def test_attributes_of_a_custom_predictor_are_restored(boat, tmp_path):
    settings = object()
    one = Twin(boat, Everything(boat, seed=1, settings=settings))
    for k in range(5):
        one.step(0.1 * k, np.zeros(10), np.zeros(4))
    one.save(tmp_path / "a")
    other = Twin.load(tmp_path / "a", Everything(boat, settings=settings)).predictor
    for key in ("x", "mask", "count", "name", "fitted", "error", "numbers", "single"):
        np.testing.assert_array_equal(getattr(one.predictor, key), getattr(other, key))
    np.testing.assert_array_equal(list(other._rows), list(one.predictor._rows))
    assert other._rows.maxlen == 3 and type(other.numbers) is list and other.numbers[0] == 1
    assert other.rng.normal() == one.predictor.rng.normal()


@pytest.mark.parametrize("value", [{"a": 1}, [1, "a"], 1j, (1, 2), np.array([object()])])
def test_attribute_that_cannot_be_saved_is_named(boat, tmp_path, value):
    predictor = Everything(boat)
    predictor.extra = value
    (tmp_path / "a").write_text("before")
    with pytest.raises(StateError, match=r"attribute 'extra' of Everything .* `constants`"):
        Twin(boat, predictor).save(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "before"


def test_torch_modules_are_restored(boat):
    torch = pytest.importorskip("torch")
    one, other = Everything(boat), Everything(boat)
    one.net, other.net = torch.nn.Linear(3, 2), torch.nn.Linear(3, 2)
    other.load_state_dict(one.state_dict())
    assert torch.equal(one.net.weight, other.net.weight)
    other.net = torch.nn.GRU(3, 2)
    with pytest.raises(StateError, match="'net' cannot be loaded"):
        other.load_state_dict(one.state_dict())


def test_option_that_cannot_be_saved_is_named(boat, tmp_path):
    twin = Twin(boat, "ukf")
    twin.options["settings"] = object()
    with pytest.raises(StateError, match=r"option 'options.settings' is a object.*as an object"):
        twin.save(tmp_path / "a")


def test_oracle_options_are_restored(boat, losses, tmp_path):
    sea = SeaState(hs=0.5, wind=4.5, current=0.3)
    one = Twin(boat, "oracle", vessel=Vessel.load("usv75"), sea=sea)
    feed(one, losses, 0, 50)
    one.save(tmp_path / "a")
    assert Twin.load(tmp_path / "a").options == {"vessel": Vessel.load("usv75"), "sea": sea}


def test_loaded_and_copied_filters_share_memory_with_their_kernels(boat, losses, tmp_path):
    twin = Twin(boat, "ukf")
    feed(twin, losses, 0, 50)
    twin.save(tmp_path / "a")
    for other in (Twin.load(tmp_path / "a"), copy.deepcopy(twin)):
        ukf = other.predictor.ukf
        ukf.memory[:] = 7.0
        assert (ukf.x == 7.0).all() and (ukf.P == 7.0).all() and (ukf.act == 7.0).all()


def test_views_of_a_record_write_to_its_memory():
    kind = np.dtype([("x", "f8", 3), ("P", "f8", (2, 2)), ("count", "f8")])
    memory = np.zeros(8)
    views = record_views(memory, kind)
    assert {name: view.shape for name, view in views.items()} == {
        "x": (3,),
        "P": (2, 2),
        "count": (1,),
    }
    views["P"][1, 0], views["count"][:] = 3.0, 4.0
    assert memory.tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 4.0]


# Files


@pytest.fixture(scope="module")
def contents(boat, losses, tmp_path_factory):
    """Files of several predictors, saved after 300 rows, as bytes."""
    found = {}
    settings = {"oracle": {"vessel": Vessel.load("usv75"), "sea": SeaState(hs=0.5, wind=4.5)}}
    for name in ("ukf", "dsw-ukf", "dsw-ukf-plus", "persistence", "var", "oracle"):
        one = Twin(boat, name, **settings.get(name, {}))
        feed(one, losses, 0, 300)
        path = tmp_path_factory.mktemp("saved") / f"{name}.twin"
        one.save(path)
        found[name] = path.read_bytes()
    return found


@pytest.fixture
def saved(contents, tmp_path):
    path = tmp_path / "boat.twin"
    path.write_bytes(contents["ukf"])
    return path


def opened(content):
    """Return header and arrays of a file."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        header = json.loads(archive.read("header.json"))
        names = [name for name in archive.namelist() if name.endswith(".npy")]
        return header, {name: np.load(io.BytesIO(archive.read(name))) for name in names}


def closed(header, arrays):
    """Return the bytes of a file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("header.json", json.dumps(header))
        for name, array in arrays.items():
            entry = io.BytesIO()
            np.save(entry, array)
            archive.writestr(name, entry.getvalue())
    return file.getvalue()


def change(path, header=None, arrays=None):
    """Write a file again with other fields; None leaves a field out."""
    head, found = opened(path.read_bytes())
    found = {k: v for k, v in (found | (arrays or {})).items() if v is not None}
    path.write_bytes(closed(head | (header or {}), found))


def test_file_names_its_fields_and_no_program(saved, contents):
    header, arrays = opened(contents["dsw-ukf-plus"])
    expected = {
        "predictor",
        "class",
        "seed",
        "options",
        "particulars",
        "t",
        "begun",
        "lost_at",
        "state",
    }
    assert set(header) == expected | {"format", "version", "software"}
    assert {"state.filter.P.npy", "state.segments.packed.npy"} <= set(arrays)
    again = Twin.load(saved)
    again.save(saved.with_name("b"))
    assert saved.read_bytes() == saved.with_name("b").read_bytes()


def test_file_is_read_after_an_edit_of_the_program(saved):
    """A docstring, a comment and a constant of another predictor are edited in a copied tree."""
    root, tree = Path(twin.__file__).parents[1], saved.parent / "tree"
    for package in ("twin", "usv_gym", "usv_kernel"):
        shutil.copytree(root / package, tree / package, ignore=shutil.ignore_patterns("*cache*"))
        for file in (tree / package).rglob("*.py"):
            file.write_text(file.read_text().replace('"""', '"""Edited. ', 1))
    code = f"""if True:
        import twin
        print(twin.__doc__[:7], repr(twin.Twin.load({str(saved)!r}).predictor.ukf.x.sum()))"""
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(tree)},
        cwd=tree,
        capture_output=True,
        text=True,
    )
    expected = f"Edited. {Twin.load(saved).predictor.ukf.x.sum()!r}"
    assert run.stdout.strip() == expected, run.stderr


def test_other_files_are_refused(tmp_path, zigzag):
    zigzag.write(tmp_path / "run.csv")
    (tmp_path / "empty").write_bytes(b"")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("run.csv", "empty", "other.npz"):
        with pytest.raises(StateError, match=f"{name}: is no saved twin"):
            Twin.load(tmp_path / name)
    with pytest.raises(StateError, match="none: cannot be read"):
        Twin.load(tmp_path / "none")


def test_cut_off_or_damaged_files_are_refused(saved):
    whole = saved.read_bytes()
    middle = whole.index(b'"particulars"') + 3
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    cuts = [whole[:size] for size in (3, len(whole) // 3, len(whole) - 100, len(whole) - 1)]
    for content in (*cuts, flipped):
        saved.write_bytes(content)
        with pytest.raises(StateError, match=r"boat.twin: .*use an earlier copy"):
            Twin.load(saved)


def test_other_format_versions_are_refused(saved, tmp_path):
    change(saved, {"version": 99, "software": "9.9"})
    with pytest.raises(
        StateError, match=rf"version 99, written by usv-twin 9\.9.* {VERSION}: load"
    ):
        Twin.load(saved)
    np.savez(tmp_path / "old.npz", header=np.zeros(3), memory=np.zeros(3))
    with pytest.raises(StateError, match=r"version 2, written by usv-twin 0\.1"):
        Twin.load(tmp_path / "old.npz")


def test_file_of_another_predictor_or_boat_is_refused(saved, boat):
    longer = dataclasses.replace(boat, length=9.0, name="other")
    with pytest.raises(StateError, match=r"'usv75' with other particulars .* than 'other'"):
        Twin.load(saved, UKFPredictor(longer))
    with pytest.raises(StateError, match="holds a UKFPredictor, not a Persistence"):
        Twin.load(saved, Persistence(boat))
    with pytest.raises(StateError, match=r"'filter.x' has shape \(\d+,\) where \(\d+\) is"):
        Twin.load(saved, UKFPredictor(boat, model="mmg"))
    change(saved, {"predictor": "nope"})
    with pytest.raises(StateError, match="the predictor 'nope', which is not known here; known: p"):
        Twin.load(saved)


def with_entry(name, entry, value):
    """Return the change of one number of one array."""

    def of(arrays):
        array = arrays[f"state.{name}.npy"].copy()
        array.flat[entry] = value
        return {f"state.{name}.npy": array}

    return name, of


@pytest.mark.parametrize(
    ("predictor", "damage", "message"),
    [
        ("ukf", with_entry("filter.x", 3, math.nan), "holds NaN"),
        ("ukf", with_entry("filter.P", 1, 1e3), "is no covariance"),
        ("ukf", with_entry("nav.begun", 0, 0.5), "not whole"),
        ("ukf", with_entry("nav.count", 0, 1e6), "outside 0.0 to 128.0"),
        ("ukf", ("filter.wind", lambda a: {"state.filter.wind.npy": np.zeros(3)}), "has shape"),
        ("ukf", ("filter.wind", lambda a: {"state.filter.wind.npy": None}), "is missing"),
        ("ukf", ("filter.more", lambda a: {"state.filter.more.npy": np.zeros(3)}), "is unknown"),
        ("dsw-ukf-plus", with_entry("selector.count", 1, 10.0), "outside"),
        ("dsw-ukf-plus", with_entry("window.halves", 0, 1e5), "ends at"),
        ("dsw-ukf-plus", with_entry("segments.first", 0, -2.0), "outside -1.0 to"),
    ],
)
def test_damaged_field_is_named(contents, tmp_path, predictor, damage, message):
    path = tmp_path / "boat.twin"
    path.write_bytes(contents[predictor])
    field, of = damage
    change(path, arrays=of(opened(contents[predictor])[1]))
    with pytest.raises(StateError, match=rf"boat.twin: field '{field}' .*{message}.*; "):
        Twin.load(path)


ODD = (None, -1, 0, 0.5, 1e9, -1e9, 1e300, math.nan, math.inf, 2**70, True, "x", [], {}, [[1]])


def mutant(content, rng):
    """Return a file with one thing changed at random: a byte, an entry, a number, a type."""
    header, arrays = opened(content)
    name = str(rng.choice(sorted(arrays)))
    array, kind = arrays[name], rng.integers(9)
    if kind == 0:
        at = int(rng.integers(len(content)))
        return content[:at] + rng.bytes(int(rng.integers(1, 9))) + content[at + 1 :]
    if kind <= 3 and array.size:
        array = arrays[name] = array.copy()
        values = [math.nan, math.inf, -math.inf, -1.0, 0.0, 0.5, 1e9, 2.0**53, 1e59, -1e300]
        some = rng.integers(array.size, size=int(rng.integers(1, 4)))
        array.flat[some] = rng.choice(values)
    elif kind == 4:
        ways = [array[:-1], array[None], array.astype("U9"), array > 0.0, np.zeros((0, 3))]
        ways += [array.real.astype(np.float32), array.ravel(), np.zeros((40, *array.shape))]
        arrays[name] = ways[int(rng.integers(len(ways)))]
    elif kind == 5:
        del arrays[name]
    elif kind == 6:
        other = str(rng.choice(sorted(arrays)))
        arrays[name], arrays[other] = arrays[other], arrays[name]
    else:
        node, key = header, str(rng.choice(sorted(set(header) - {"software"})))
        while isinstance(node[key], dict) and node[key] and rng.random() < 0.9:
            node = node[key]
            key = str(rng.choice(sorted(node)))
        if rng.random() < 0.2:
            del node[key]
        else:
            node[key] = ODD[int(rng.integers(len(ODD)))]
    return closed(header, arrays)


def load_mutants(contents, losses, folder, count, seed):
    """Load mutants: each gives a sentence, or a twin that goes on."""
    rng, path, loaded = np.random.default_rng(seed), folder / "mutant.twin", 0
    for k in range(count):
        path.write_bytes(mutant(list(contents.values())[k % len(contents)], rng))
        message = ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                twin = Twin.load(path)
        except StateError as error:
            message = str(error)
        if message:
            assert message.startswith(f"{path}: ") and "; " in message and "\n" not in message
            continue
        loaded += 1
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            first = int(np.searchsorted(losses.t, twin.t, side="right")) if twin.t == twin.t else 0
            feed(twin, losses, first, min(first + 50, len(losses)))
            twin.predict("hold")
    assert 0.02 * count < loaded < 0.6 * count


def test_damaged_files_do_no_harm(contents, losses, tmp_path):
    load_mutants(contents, losses, tmp_path, count=300, seed=1)


@pytest.mark.slow
def test_many_damaged_files_do_no_harm(contents, losses, tmp_path):
    load_mutants(contents, losses, tmp_path, count=2000, seed=2)


def test_power_cut_keeps_the_old_file(saved, losses, monkeypatch):
    before = saved.read_bytes()
    twin = Twin.load(saved)
    feed(twin, losses, 300, 320)

    def cut(*_):
        raise OSError("no power")

    monkeypatch.setattr(os, "fsync", cut)
    with pytest.raises(OSError, match="no power"):
        twin.save(saved)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]
