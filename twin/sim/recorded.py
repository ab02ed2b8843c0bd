"""Recorded runs with the particulars of their boats."""

from __future__ import annotations

import dataclasses
import math
import shlex
from pathlib import Path

from twin.digital_twin import Twin, TwinError
from twin.logs.autopilot.outputs import particulars_of_parameters
from twin.logs.autopilot.readers import is_autopilot_log, parameters_of
from twin.logs.datasets import known_ship
from twin.logs.log import Log, mapping_of, sibling_path
from twin.logs.mapping import Layout
from twin.particulars import Particulars, ParticularsError
from twin.predictors.own_prior import prior_note
from twin.predictors.registry import DEFAULT, predictor_class
from twin.sim.bridge import particulars_of
from twin.sim.oracle import check_simulator
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_kernel.files import read_toml

__all__ = [
    "has_particulars",
    "particulars_for_log",
    "read_run",
    "twin_for_log",
]


def log_name(path: str) -> str:
    """Return the name of a recorded run."""
    return sibling_path(path, "").name


def read_run(
    path: str, ship: str | None = None, mapping: str | None = None
) -> tuple[Log, Particulars]:
    """Return a recorded run and its boat's particulars.

    See :func:`particulars_for_log` and ``Log.read``.
    """
    return Log.read(path, mapping), particulars_for_log(path, ship, mapping)


def has_particulars(path: str | Path) -> bool:
    """Return whether a log states its boat: in a file next to it, or by columns that are known."""
    return sibling_path(path, ".toml").exists() or known_ship(path) is not None


def particulars_for_log(
    path: str | Path, ship: str | None = None, mapping: str | Path | None = None
) -> Particulars:
    """Return the particulars for a log.

    They are those of ``ship``, else those in ``<log>.toml`` next to the log, else those of a boat
    that is known by the columns of the log. ``ship`` is a TOML file of particulars, of one boat or
    several (``[[ship]]``, see :meth:`twin.particulars.Particulars.load`). Or it is the name or file
    of a vessel of ``usv_gym``. ``<log>.toml`` may be a vessel file as well. ParticularsError,
    VesselError: file and remedy; a log without particulars is such an error.

    A vessel that an autopilot's log is of gets the log's unit of shaft speed, and the places of
    its sensors, from the autopilot's parameters. ``mapping`` is that of the log.
    """
    file = sibling_path(path, ".toml")
    known = known_ship(path) if ship is None and not file.exists() else None
    if known is not None:
        return known
    if ship is None and not file.exists():
        names = ", ".join(vessel_names())
        given = (path,) if mapping is None else (path, "--mapping", mapping)
        options = shlex.join(str(each) for each in given)
        target = shlex.quote(str(file))
        raise ParticularsError(
            _NO_PARTICULARS.format(path=path, options=options, file=target, names=names)
        )
    beside, ship = ship is None, str(file) if ship is None else ship
    tables = _tables_of(ship) if Path(ship).suffix == ".toml" else set[str]()
    if beside and tables and tables.isdisjoint(_BOAT):
        raise ParticularsError(
            f"{file}: has the name of {path}, and so is read as the particulars of its boat, but "
            f"holds [{'], ['.join(sorted(tables))}]: give it another name (that of a mapping is "
            f"{sibling_path(path, '.mapping.toml').name}), or name the boat with --ship"
        )
    if "hull" not in tables and (beside or tables):
        return Particulars.load(ship, log=path)
    vessel = Vessel.load(ship)
    if not is_autopilot_log(Path(path)):
        return particulars_of(vessel)
    found = mapping_of(Path(path), mapping)
    servos = {} if found is None else Layout.load(found).servos
    # its accelerometers also measure the tilt
    boat, parameters = particulars_of(vessel, dof=6), parameters_of(Path(path))
    return particulars_of_parameters(boat, parameters, servos, str(path))


def twin_for_log(
    path: str | Path,
    predictor: str | None = None,
    *,
    ship: str | None = None,
    mapping: str | Path | None = None,
    until: float | None = None,
    own_prior: bool = True,
) -> tuple[Log, Twin]:
    """Return a log without its truth, and the twin that is to run over it.

    Parameters
    ----------
    path, ship, mapping
        As for :func:`read_run`.
    predictor : str, optional
        Its name, with options behind a colon.
    until : float, optional
        Rows after this time are left out, s.
    own_prior : bool
        Whether the twin begins with the prior of the particulars, if they have one.

    Raises
    ------
    UsvTwinError
        Where the log cannot be read, or has no row left.
    """
    name = predictor or DEFAULT
    predictor_class(name)
    log = Log.read(path, mapping)
    boat = particulars_for_log(path, ship, mapping)
    check_simulator(name, log, boat)
    boat = boat if own_prior else dataclasses.replace(boat, prior=None)
    twin = Twin(boat, name)
    unused = prior_note(twin.predictor, str(twin.name))
    log = dataclasses.replace(
        log.without_truth(), notes=(*log.notes, *([unused] if unused else ()))
    )
    twin.locate(log.datum)
    if until is not None:
        if not math.isfinite(until):
            raise TwinError(f"until = {until}: must be a finite time in s")
        log = log.slice(-math.inf, math.nextafter(until, math.inf))
        if len(log) == 0:
            raise TwinError(f"until = {until:g}: {path} has no row before it")
    return log, twin


_NO_PARTICULARS = (
    "{path}: no particulars of the boat. This writes them, as far as the log shows them: "
    "usv-twin check {options} --write {file}. Then fill in length, beam, draft and mass there. "
    "Or name the boat with --ship FILE or --ship NAME ({names})"
)


_BOAT = ("particulars", "instruments", "deck", "ship", "hull")
"""Tables of a file that describes a boat."""


def _tables_of(path: str) -> set[str]:
    try:
        return {*read_toml(path, ParticularsError)}
    except ParticularsError:
        return set()  # whoever reads it says why
