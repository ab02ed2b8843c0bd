"""A twin that is saved and loaded goes on as if it had never stopped."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections import deque, namedtuple
from types import MappingProxyType

import numpy as np
import pytest

from twin import StateError, Twin
from twin.checkpoint import read, write
from twin.identification.filter_settings import plain_settings
from twin.logs.log import Log
from twin.predictors.baselines import Persistence
from twin.predictors.ukf import UKFPredictor
from usv_gym import SeaState, Vessel

STOPS = (0, 7, 430, 533, 650)
"""Rows after which a run is interrupted: never fed; before the first fix; while the GPS is
gone; in the middle of a window, while the IMU is gone; after the losses."""
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


def test_same_bits_as_without_a_stop(name, make_twin, losses, tmp_path):
    whole, fed = make_twin(name), 0
    for stop in STOPS:
        feed(whole, losses, fed, stop)
        whole.save(tmp_path / f"{stop}.twin")
        fed = stop
    feed(whole, losses, fed, END)
    for stop in STOPS:
        twin = Twin.load(tmp_path / f"{stop}.twin")
        assert type(twin.predictor) is type(whole.predictor)
        feed(twin, losses, stop, END)
        same(whole, twin)


def test_the_first_answer_after_a_load(name, make_twin, losses, tmp_path):
    """Also what is asked at once, and after a second save, is that of the twin that was saved."""
    twin = make_twin(name)
    feed(twin, losses, 0, 450)
    twin.save(tmp_path / "a")
    once = Twin.load(tmp_path / "a")
    once.save(tmp_path / "b")
    same(twin, once)
    twice = Twin.load(tmp_path / "b")
    same(twin, twice)
    once.reset()
    fresh = make_twin(name)
    same(fresh, once)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("dsw-ukf", {"adapt": "literal", "window": "fixed"}),
        ("dsw-ukf", {"adapt": "signed", "p0": np.full(31, 0.5)}),
        ("dsw-ukf-plus", {"model": "mmg", "period": 2.0}),
        ("ukf", {"model": "mmg"}),
    ],
)
def test_options_are_kept(boat, losses, tmp_path, name, options):
    twin = Twin(boat, name, **options)
    feed(twin, losses, 0, 300)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    np.testing.assert_equal(again.options, options)
    for one in (twin, again):
        feed(one, losses, 300, 500)
    same(twin, again)


@pytest.mark.parametrize("design", ["", "usv75"])
def test_the_class_is_kept(boat, losses, tmp_path, design):
    twin = Twin(dataclasses.replace(boat, design=design))
    feed(twin, losses, 0, 200)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    assert again.particulars.design == design
    assert again.predictor.particulars == twin.particulars
    for one in (twin, again):
        feed(one, losses, 200, 400)
    same(twin, again)


def test_a_boat_that_was_saved_before_there_were_classes_is_of_none(boat, losses, tmp_path):
    """Its file has no such attribute."""
    twin = Twin(dataclasses.replace(boat, design=""))
    feed(twin, losses, 0, 200)
    twin.save(tmp_path / "a")

    def without(header):
        (node,) = (n for n in header["nodes"] if n[1] == "twin.particulars:Particulars")
        node[2] = [field for field in node[2] if field[0] != "design"]

    rewrite(tmp_path / "a", without)
    again = Twin.load(tmp_path / "a")
    assert again.particulars == twin.particulars
    same(twin, again)


def test_settings_are_kept(boat, losses, tmp_path):
    twin = Twin(boat, "ukf", settings=dataclasses.replace(plain_settings(boat), alpha=0.5))
    feed(twin, losses, 0, 100)
    twin.save(tmp_path / "a")
    again = Twin.load(tmp_path / "a")
    assert again.options["settings"].alpha == 0.5
    assert again.predictor.ukf.settings is again.options["settings"]


class Own(Persistence):
    """A predictor of somebody else's, which draws random numbers."""

    def reset(self):
        super().reset()
        self.rng = np.random.default_rng(self.seed)
        self.noise = 0.0

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        self.noise = self.rng.normal()


def test_predictor_of_ones_own(boat, losses, tmp_path):
    twin = Twin(boat, Own(boat, seed=5))
    feed(twin, losses, 0, 300)
    twin.save(tmp_path / "a")
    with pytest.raises(StateError, match=r"Twin\.load\(path, predictor=\.\.\.\)"):
        Twin.load(tmp_path / "a")
    with pytest.raises(StateError, match="not known here"):
        Twin.load(tmp_path / "a", UKFPredictor(boat))
    again = Twin.load(tmp_path / "a", Own(boat))
    for one in (twin, again):
        feed(one, losses, 300, 400)
    assert twin.predictor.noise == again.predictor.noise
    same(twin, again)


def test_views_stay_views(boat, losses, tmp_path):
    twin = Twin(boat, "ukf")
    feed(twin, losses, 0, 50)
    twin.save(tmp_path / "a")
    ukf = Twin.load(tmp_path / "a").predictor.ukf
    ukf.memory[:] = 7.0
    assert (ukf.x == 7.0).all() and (ukf.P == 7.0).all() and (ukf.act == 7.0).all()


Pair = namedtuple("Pair", "a b")


class Slotted:
    __slots__ = ("x", "y")


class Thing:
    """One of everything that may be kept."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        table = rng.normal(size=(4, 6))
        self.table, self.corner, self.back = table, table[1:3, ::2], table[::-1]
        self.column = np.asfortranarray(table)
        self.none, self.empty, self.zero = None, np.zeros((0, 4)), np.array(3.0)
        self.flags, self.words = np.array([True, False]), np.array(["a", "bcd"])
        self.fixed = np.broadcast_to(rng.normal(size=3), (2, 3))
        self.single, self.big, self.special = np.float32(0.1), 2**80, [math.nan, -math.inf, -0.0]
        self.queue = deque([1, (2, [3])], maxlen=3)
        self.map = {("gps", b"\x00\xff"): self.corner, 3: "three"}
        self.view = MappingProxyType({"k": {1, 2}, "f": frozenset("ab")})
        self.pair, self.rng = Pair(1, table), rng
        self.slotted = Slotted()
        self.slotted.x = self.queue
        self.me, self.twice = self, [self.special, self.special]
        self.missing = np.array([[None], [1.5]])
        self.inverse = np.linalg.inv


def test_kinds_of_attributes(tmp_path):
    thing = Thing(1)
    write(tmp_path / "a", {"thing": thing})
    fresh = Thing(2)
    got = read(tmp_path / "a").restore("thing", fresh)
    assert got is fresh and got.me is got and got.inverse is np.linalg.inv
    for key in (
        "table",
        "corner",
        "back",
        "column",
        "empty",
        "zero",
        "flags",
        "words",
        "fixed",
        "missing",
    ):
        before, after = getattr(thing, key), getattr(got, key)
        np.testing.assert_array_equal(before, after)
        assert before.dtype == after.dtype and before.strides == after.strides
        assert before.flags.writeable == after.flags.writeable
    assert type(got.single) is np.float32 and got.single == thing.single
    assert got.big == 2**80 and got.none is None
    assert repr(got.special) == repr(thing.special)
    assert got.queue == thing.queue and got.queue.maxlen == 3 and got.slotted.x is got.queue
    assert list(got.map) == list(thing.map) and got.map["gps", b"\x00\xff"] is got.corner
    assert got.view == thing.view and type(got.view) is MappingProxyType
    assert type(got.pair) is Pair and got.pair.b is got.table
    assert got.twice[0] is got.special and got.twice[1] is got.special
    got.table[:] = 1.0
    assert (got.corner == 1.0).all() and (got.back == 1.0).all()
    assert not (got.column == 1.0).any()
    np.testing.assert_array_equal(got.rng.normal(size=9), thing.rng.normal(size=9))


def test_torch_modules(tmp_path):
    torch = pytest.importorskip("torch")
    one, other = torch.nn.Linear(3, 2), torch.nn.Linear(3, 2)
    write(tmp_path / "a", {"net": one})
    read(tmp_path / "a").restore("net", other)
    assert torch.equal(one.weight, other.weight) and torch.equal(one.bias, other.bias)
    with pytest.raises(StateError, match="where there is none"):
        read(tmp_path / "a").restore("net", torch.nn.GRU(3, 2))


def test_what_the_oracle_is_told(tmp_path):
    boat, sea = Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
    write(tmp_path / "a", {"world": {"vessel": boat, "sea": sea}})
    assert read(tmp_path / "a").restore("world") == {"vessel": boat, "sea": sea}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (lambda: 0, r"thing\.extra is a function, which cannot be saved"),
        ((i for i in range(3)), r"thing\.extra is a generator"),
        (1j, r"thing\.extra is a complex"),
        (np.array([object()]), r"thing\.extra\[0\] is a object"),
        (np.zeros(2, dtype="f8,i4"), r"thing\.extra is an array of \["),
        ({"a": [object()]}, r"thing\.extra\['a'\]\[0\] is a object"),
    ],
)
def test_what_cannot_be_saved_is_named(tmp_path, value, message):
    thing = Thing()
    thing.extra = value
    (tmp_path / "a").write_text("before")
    with pytest.raises(StateError, match=message):
        write(tmp_path / "a", {"thing": thing})
    assert (tmp_path / "a").read_text() == "before"


@pytest.fixture
def saved(boat, losses, tmp_path):
    twin = Twin(boat, "ukf")
    feed(twin, losses, 0, 100)
    twin.save(tmp_path / "boat.twin")
    return tmp_path / "boat.twin"


def rewrite(path, change, memory=None):
    """Write a file again with another header."""
    with np.load(path) as archive:
        header, kept = json.loads(archive["header"].tobytes()), archive["memory"]
    change(header)
    with path.open("wb") as file:
        np.savez(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), memory=kept)


def test_not_such_a_file(tmp_path, zigzag):
    zigzag.write(tmp_path / "run.csv")
    (tmp_path / "empty").write_bytes(b"")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("run.csv", "empty", "other.npz"):
        with pytest.raises(StateError, match=f"{name}: is no saved state of a twin"):
            Twin.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        Twin.load(tmp_path / "none")


def test_cut_off_or_damaged(saved):
    whole = saved.read_bytes()
    for size in (3, len(whole) // 3, len(whole) - 100, len(whole) - 1):
        saved.write_bytes(whole[:size])
        with pytest.raises(StateError, match="is cut off or damaged; use an earlier copy"):
            Twin.load(saved)
    middle = len(whole) // 2
    saved.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    with pytest.raises(StateError, match="is cut off or damaged"):
        Twin.load(saved)


def test_other_format(saved):
    rewrite(saved, lambda header: header.update(version=99, software="9.9"))
    with pytest.raises(StateError, match=r"has format 99, and this usv-twin reads 2; .*9\.9"):
        Twin.load(saved)


def test_other_program(saved):
    """Of the same version even: compiled code reads memory by places that a change may move."""
    rewrite(saved, lambda header: header.update(program="0" * 20))
    with pytest.raises(StateError, match=r"another version of usv-twin .*program 0{20}; .*anew"):
        Twin.load(saved)


def test_unknown_predictor(saved):
    rewrite(saved, lambda header: header["parts"].update(name="nope"))
    with pytest.raises(StateError, match="the predictor 'nope', which is not known here; known: p"):
        Twin.load(saved)


def test_made_for_others(saved, boat):
    longer = dataclasses.replace(boat, length=9.0, name="other")
    with pytest.raises(StateError, match=r"'usv75' with other particulars .* than 'other'"):
        Twin.load(saved, UKFPredictor(longer))
    with pytest.raises(StateError, match="holds a UKFPredictor, not a Persistence"):
        Twin.load(saved, Persistence(boat))


def test_another_layout(saved, boat):
    """A model with more parameters, and attributes that lack."""
    with pytest.raises(StateError, match=r"an array of shape \(\d+,\) where \(\d+,\) is needed"):
        Twin.load(saved, UKFPredictor(boat, model="mmg"))
    fresh = UKFPredictor(boat)
    fresh.newer = 1
    with pytest.raises(StateError, match="no newer for"):
        Twin.load(saved, fresh)


def test_no_code_from_a_file(saved):
    """A file names classes of the packages only, and no functions that are not there before."""

    def strange(header):
        for node in header["nodes"]:
            if node[0] == "object":
                node[1] = "subprocess:Popen"

    rewrite(saved, strange)
    with pytest.raises(StateError, match="the class subprocess:Popen, which is not known here"):
        Twin.load(saved)


def test_header_out_of_joint(saved):
    rewrite(saved, lambda header: header.update(nodes=header["nodes"][:5]))
    with pytest.raises(StateError, match="is damaged in"):
        Twin.load(saved)


def test_power_cut_keeps_the_old_file(saved, boat, losses, monkeypatch):
    before = saved.read_bytes()
    twin = Twin.load(saved)
    feed(twin, losses, 100, 120)

    def cut(*_):
        raise OSError("no power")

    monkeypatch.setattr(os, "fsync", cut)
    with pytest.raises(OSError, match="no power"):
        twin.save(saved)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]
