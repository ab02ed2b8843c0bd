"""Saved twins: fields by name, the same bits after a load, and a sentence for every other file."""

import copy
import dataclasses
import json
import math
import zipfile
from collections import deque

import numpy as np
import pytest

import twin
from twin import Prediction, Predictor, StateError, Twin, make_predictor
from twin.channels import APPARENT_FROM, APPARENT_SPEED
from twin.files import ARCHIVE_MAX
from twin.logs.log import Log
from twin.model.dynamics import model_of
from twin.model.priors import population_prior
from twin.predictors.baselines import Persistence
from twin.predictors.ukf import UKFPredictor
from twin.sim.bridge import particulars_of
from usv_gym import SeaState, Vessel
from usv_kernel.channels import GYRO

STOPS = (0, 7, 430, 533, 650)
"""Rows after which a run is interrupted: never started; before the first fix; while the GPS is
lost; in the middle of a window, while the IMU is lost; after the losses."""
END = 750


@pytest.fixture(scope="module")
def losses(zigzag) -> Log:
    """The zigzag with no fix in the first 0.5 s, without GPS from 20 to 25 s, then without IMU.

    The gyro turns the wrong way from 10 s on, and the wind blows from everywhere.
    """
    z, rng = zigzag.z.copy(), np.random.default_rng(0)
    z[200:, GYRO] *= -1.0
    z[:, [APPARENT_SPEED, APPARENT_FROM]] = rng.uniform(0.0, 6.0, (len(z), 2))
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
        *(twin.t, twin.cmd, twin.monitor.memory),
    ]


def same(one, other):
    for a, b in zip(answers(one), answers(other), strict=True):
        np.testing.assert_array_equal(a, b)


def load(path, like):
    """Load a twin; one whose predictor was handed in as an object gets a new one."""
    return Twin.load(path, like.predictor if like.name is None else None)


def test_restored_twin_gives_the_same_bits(name, make_twin, losses, tmp_path):
    whole, row = make_twin(name), 0
    for stop in STOPS:
        feed(whole, losses, row, stop)
        whole.save(tmp_path / f"{stop}.twin")
        row = stop
    feed(whole, losses, row, END)
    for stop in STOPS:
        twin = load(tmp_path / f"{stop}.twin", make_twin(name))
        assert type(twin.predictor) is type(whole.predictor)
        feed(twin, losses, stop, END)
        same(whole, twin)
    assert whole.health["gyro"].status == "excluded"
    same(whole, copy.deepcopy(whole))
    twin.reset()
    same(make_twin(name), twin)


USV75 = particulars_of(Vessel.load("usv75"))
PRIOR = population_prior(model_of(USV75, "mmg", biased=True, current=True), USV75)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("dsw-ukf-plus", {"prior": (PRIOR[0], 2.0 * PRIOR[1])}),
        ("dsw-ukf", {"adapt": "signed", "p0": np.full(31, 0.5)}),
        ("dsw-ukf-plus", {"model": "mmg", "period": 2.0}),
    ],
)
def test_options_and_particulars_are_restored(boat, losses, tmp_path, name, options):
    twin = Twin(dataclasses.replace(boat, design=""), name, **options)
    feed(twin, losses, 0, 100)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    np.testing.assert_equal(again.options, options)
    assert again.particulars == twin.particulars
    for one in (twin, again):
        feed(one, losses, 100, 200)
    same(twin, again)


def test_an_option_that_cannot_be_saved_is_named_with_the_remedy(boat, losses, tmp_path):
    sea = SeaState(hs=0.5, wind=4.5)
    twin = Twin(boat, "oracle", sea=sea)
    with pytest.raises(
        StateError, match=r"option 'sea' is a SeaState.*hand the predictor in as an"
    ):
        twin.save(tmp_path / "a")
    twin = Twin(boat, make_predictor("oracle", boat, sea=sea))
    feed(twin, losses, 0, 100)
    twin.save(tmp_path / "a")
    same(twin, Twin.load(tmp_path / "a", make_predictor("oracle", boat, sea=sea)))


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


def test_attributes_of_a_predictor_given_as_object_are_restored(boat, tmp_path):
    settings = object()
    one = Twin(boat, Everything(boat, seed=1, settings=settings))
    for k in range(5):
        one.step(0.1 * k, np.zeros(10), np.zeros(4))
    one.save(tmp_path / "a")
    for wrong in (None, UKFPredictor(boat)):
        with pytest.raises(StateError, match="Everything"):
            Twin.load(tmp_path / "a", wrong)
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
    with pytest.raises(StateError, match="extra"):
        Twin(boat, predictor).save(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "before"


def test_torch_modules_are_restored(boat):
    torch = pytest.importorskip("torch")
    one, other = Everything(boat), Everything(boat)
    one.net, other.net = torch.nn.Linear(3, 2), torch.nn.Linear(3, 2)
    other.load_state_dict(one.state_dict())
    assert torch.equal(one.net.weight, other.net.weight)
    other.net = torch.nn.GRU(3, 2)
    with pytest.raises(StateError, match="net"):
        other.load_state_dict(one.state_dict())


# Files


@pytest.fixture
def saved(boat, losses, tmp_path):
    """A file of a twin, saved after 300 rows."""
    one = Twin(boat, "ukf")
    feed(one, losses, 0, 300)
    one.save(tmp_path / "boat.twin")
    return tmp_path / "boat.twin"


def change(path, header=None, arrays=None):
    """Write a file again with other entries; None leaves an array out."""
    with np.load(path) as archive:
        entries = {name: archive[name] for name in archive.files}
    about = json.loads(str(entries["header"])) | (header or {})
    entries |= {"header": np.array(json.dumps(about))}
    entries |= {f"state.{name}": array for name, array in (arrays or {}).items()}
    whole = {name: array for name, array in entries.items() if array is not None}
    with path.open("wb") as file:
        np.savez_compressed(file, **whole)


def test_a_state_gives_the_same_bytes_again(saved):
    Twin.load(saved).save(saved.with_name("b"))
    assert saved.read_bytes() == saved.with_name("b").read_bytes()


def test_other_files_are_refused(saved, tmp_path, zigzag):
    zigzag.write(tmp_path / "run.csv")
    (tmp_path / "empty").write_bytes(b"")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("run.csv", "empty", "other.npz", "none"):
        with pytest.raises(StateError, match=name):
            Twin.load(tmp_path / name)
    with zipfile.ZipFile(saved, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("state.more.npy", bytes(ARCHIVE_MAX + 1))
    with pytest.raises(StateError, match="more or other"):  # before it is unpacked
        Twin.load(saved)


def test_cut_off_or_damaged_files_are_refused(saved):
    whole, rng = saved.read_bytes(), np.random.default_rng(0)
    # what Python's zipfile reads: the entries, not the dates and the like between them
    with zipfile.ZipFile(saved) as archive:
        entry = max(archive.infolist(), key=lambda info: info.compress_size)
    extra = int.from_bytes(whole[entry.header_offset + 28 :][:2], "little")
    begin = entry.header_offset + 30 + len(entry.filename) + extra
    places = (begin + rng.integers(entry.compress_size, size=50)).tolist()
    damaged = [whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :] for k in places]
    cuts = [whole[:size] for size in (3, len(whole) // 3, len(whole) - 100, len(whole) - 1)]
    for content in (*cuts, *damaged):
        saved.write_bytes(content)
        with pytest.raises(StateError, match="use an earlier copy"):
            Twin.load(saved)


def test_another_format_version_is_refused(saved):
    change(saved, {"version": 99, "software": "9.9"})
    with pytest.raises(StateError, match=r"version 99, written by usv-twin 9\.9"):
        Twin.load(saved)


def test_file_of_another_predictor_or_boat_is_refused(saved, boat):
    longer = dataclasses.replace(boat, length=9.0, name="other")
    for wrong in (UKFPredictor(longer), Persistence(boat), UKFPredictor(boat, model="mmg")):
        with pytest.raises(StateError):
            Twin.load(saved, wrong)
    change(saved, {"predictor": "nope"})
    with pytest.raises(StateError, match="nope"):
        Twin.load(saved)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("filter.wind", np.zeros(3)),
        ("filter.wind", np.array(["a", "b"])),
        ("filter.wind", None),
        ("filter.more", np.zeros(3)),
    ],
)
def test_a_field_that_does_not_fit_is_named(saved, name, array):
    change(saved, arrays={name: array})
    with pytest.raises(StateError, match=rf"boat.twin: field '{name}'"):
        Twin.load(saved)
