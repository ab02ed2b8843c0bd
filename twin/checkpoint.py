"""Objects in a file, to go on from later: all that they remember, and nothing that could run.

:func:`write` walks the attributes of objects into plain data: numbers, texts, containers,
arrays, generators of random numbers, torch modules, and objects of such. :func:`read` puts
them back. What was shared stays shared: two names of one list, and arrays that are views of
one memory, which compiled filters rely on. So an object that goes on from its file gives the
same bits as one that never stopped.

The file is a zip archive in numpy's npz format with two entries: ``header`` (JSON, UTF-8) and
``memory`` (the bytes of all arrays, one after the other). It holds no code and no pickles:
classes are looked up by name in the packages of :data:`PACKAGES` or in the object that is
restored into, their constructors do not run, and functions stay those of that object.

Compiled code finds what it needs by places that are fixed in the program. So a file is read by the
very program that wrote it, known by a digest of its sources; another may have moved them.
"""

from __future__ import annotations

import ctypes
import io
import json
import sys
import zipfile
from collections import deque
from importlib import import_module
from pathlib import Path, PurePath
from types import FunctionType, MappingProxyType, MethodType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from twin.files import write_whole
from usv_kernel import __version__
from usv_kernel.cache import running_program
from usv_kernel.errors import UsvTwinError

__all__ = [
    "VERSION",
    "Reader",
    "StateError",
    "read",
    "write",
]

FORMAT = "usv-twin state"

VERSION = 2
"""Version of the format; a file of another one is refused."""

PACKAGES = ("twin", "filterpy", "usv_gym", "usv_kernel")
"""Packages whose classes a file may name."""

_SCALARS = (type(None), bool, int, float, str)

_SEQUENCES: dict[str, Any] = {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}

_ALIGNED = 64
"""Bytes between which the memories of arrays begin."""


class StateError(UsvTwinError):
    """A file or object that cannot be used; the message names it and the remedy."""


def write(path: str | Path, parts: dict[str, Any]) -> None:
    """Write objects to a file, whole or not at all: a power cut leaves the file before.

    Parameters
    ----------
    path : str or Path
        File; written over if it is there.
    parts : dict
        What to write, by name; what they share stays shared.

    Raises
    ------
    StateError
        Names what in them is no plain data.
    """
    write_whole(Path(path), pack(parts))


def pack(parts: dict[str, Any]) -> bytes:
    """Return what :func:`write` writes; arguments and errors are the same."""
    walk = _Walk()
    values = {name: walk.value(part, name) for name, part in parts.items()}
    memory, blocks, places = walk.memory()
    header = {
        **{"format": FORMAT, "version": VERSION, "software": __version__},
        **{"program": running_program()},
        **{"parts": values, "nodes": walk.nodes, "blocks": blocks, "arrays": places},
    }
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez(file, header=text, memory=memory)
    return file.getvalue()


def copied(kind: type[Any], content: bytes) -> Any:
    """Return the object that :func:`pack` packed as the part ``it``: a deep copy.

    Unlike one by ``copy.deepcopy``, its arrays share memory where the original's do.

    Parameters
    ----------
    kind : type
        Its class.
    content : bytes
        What :func:`pack` gave.
    """
    reader = unpack(content, Path("copy"))
    reader.trusted = True
    return reader.restore("it", object.__new__(kind))


def read(path: str | Path) -> Reader:
    """Open what :func:`write` wrote.

    Parameters
    ----------
    path : str or Path
        The file.

    Raises
    ------
    StateError
        It is no such file, is cut off or damaged, or has another format.
    """
    return unpack(Path(path).read_bytes(), Path(path))


def unpack(content: bytes, path: Path) -> Reader:
    """Return a reader of the content of a file; ``path`` is for messages."""
    header: Any = None
    try:
        if content.startswith(b"PK"):
            with np.load(io.BytesIO(content), allow_pickle=False) as archive:
                if {"header", "memory"} <= set(archive.files):
                    header, memory = json.loads(archive["header"].tobytes()), archive["memory"]
    except (zipfile.BadZipFile, EOFError, OSError, ValueError, NotImplementedError):
        raise StateError(f"{path}: is cut off or damaged; use an earlier copy") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise StateError(
            f"{path}: is no saved state of a twin; choose a file that was saved by one"
        )
    if header.get("version") != VERSION:
        raise StateError(
            f"{path}: has format {header.get('version')}, and this usv-twin reads {VERSION}; "
            f"load it with usv-twin {header.get('software')}, which wrote it"
        )
    if header.get("program") != running_program():
        raise StateError(
            f"{path}: was saved by another version of usv-twin ({header.get('software')}, program "
            f"{header.get('program')}; this is {__version__}, {running_program()}), which may lay "
            "out its memory otherwise; load it with that one, or begin anew"
        )
    return Reader(path, header, memory)


class _Walk:
    """Turns objects into a table of nodes, each object once, and blocks of memory.

    A value is a scalar, or [i] for the i-th node; a node is its kind and what that needs.
    """

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.arrays: list[NDArray[Any]] = []
        self._seen: dict[int, int] = {}
        # an id is that of one object only as long as the object lives
        self._alive: list[Any] = []

    def value(self, value: Any, where: str) -> Any:
        """Return the value, or the reference to its node."""
        if type(value) in _SCALARS:
            return value
        if id(value) not in self._seen:
            self._seen[id(value)] = len(self.nodes)
            self._alive.append(value)
            self.nodes.append(None)
            index = self._seen[id(value)]
            self.nodes[index] = self._node(value, where)
        return [self._seen[id(value)]]

    def _node(self, value: Any, where: str) -> list[Any]:
        kind = type(value)
        if kind is np.ndarray and value.dtype == object:
            return ["objects", value.shape, self._items(value.ravel(), where)]
        if kind is np.ndarray:
            return ["array", *self._array(value, where)]
        if isinstance(value, np.generic):
            return ["scalar", self.value(np.array(value), where)]
        if kind.__name__ in _SEQUENCES and kind is _SEQUENCES[kind.__name__]:
            return [kind.__name__, self._items(value, where)]
        if kind is deque:
            return ["deque", self._items(value, where), value.maxlen]
        if kind is dict or kind is MappingProxyType:
            pairs = [
                [self.value(k, f"{where} (key)"), self.value(v, f"{where}[{k!r}]")]
                for k, v in value.items()
            ]
            return ["dict" if kind is dict else "mapping", pairs]
        if kind is bytes:
            return ["bytes", value.hex()]
        if isinstance(value, PurePath):
            return ["path", str(value)]
        if isinstance(value, np.random.Generator):
            state = value.bit_generator.state
            return ["generator", self.value(state, where)]
        if hasattr(value, "load_state_dict"):
            weights = {k: v.detach().cpu().numpy() for k, v in value.state_dict().items()}
            return ["torch", _name_of(kind), self.value(weights, where)]
        if callable(value) and hasattr(value, "__qualname__") and _found(_name_of(value)) is value:
            return ["function", _name_of(value)]
        if isinstance(value, tuple):
            return ["named", _name_of(kind), self._items(value, where)]
        names = _attributes(value)
        strange = (*_SCALARS[1:], list, dict, set, deque, FunctionType, MethodType)
        if names is None or isinstance(value, strange):
            raise StateError(
                f"{where} is a {kind.__name__}, which cannot be saved; "
                "keep numbers, texts, arrays, containers and objects of those in it"
            )
        fields = [[n, self.value(getattr(value, n), f"{where}.{n}")] for n in names]
        return ["object", _name_of(kind), fields]

    def _items(self, values: Any, where: str) -> list[Any]:
        return [self.value(item, f"{where}[{i}]") for i, item in enumerate(values)]

    def _array(self, array: NDArray[Any], where: str) -> list[Any]:
        """Return block, offset, type, shape, strides, and whether it may be written."""
        if array.dtype.kind not in "biufcSUmM":
            raise StateError(
                f"{where} is an array of {array.dtype}, which cannot be saved; use numbers"
            )
        self.arrays.append(array)
        return [
            len(self.arrays) - 1,
            array.dtype.str,
            array.shape,
            array.strides,
            bool(array.flags.writeable),
        ]

    def memory(self) -> tuple[NDArray[np.uint8], list[list[int]], list[list[int]]]:
        """Return the memory of all arrays, its blocks, and block and offset of each array.

        A block (first byte, size) is what arrays that overlap cover together.
        """
        spans = [_span(array) for array in self.arrays]
        blocks: list[list[int]] = []
        places = [[0, 0] for _ in spans]
        content, end = bytearray(), -1
        for i in sorted(range(len(spans)), key=spans.__getitem__):
            first, last = spans[i]
            if first >= end:
                blocks.append([first, 0])
            places[i] = [len(blocks) - 1, _address(self.arrays[i]) - blocks[-1][0]]
            end = max(end, last) if first < end else last
            blocks[-1][1] = end - blocks[-1][0]
        for block in blocks:
            # the arrays are alive, and so is all that lies between their ends
            address, block[0] = block[0], len(content)
            content += ctypes.string_at(address, block[1]) + bytes(-block[1] % _ALIGNED)
        return np.frombuffer(content, dtype=np.uint8), blocks, places


class Reader:
    """A file that was read: gives back its parts.

    Parameters
    ----------
    path : Path
        Where it was, for messages.
    header : dict
        Its header.
    memory : ndarray of uint8
        Its memory.
    """

    def __init__(self, path: Path, header: dict[str, Any], memory: NDArray[np.uint8]) -> None:
        self.path = path
        self.trusted = False
        """Whether functions are looked up: in a copy within a program, never in a file."""
        self._header, self._memory = header, memory
        self._made: dict[int, Any] = {}
        self._blocks: dict[int, NDArray[np.uint8]] = {}

    def restore(self, part: str, fresh: Any = None) -> Any:
        """Return a part of the file.

        Parameters
        ----------
        part : str
            Its name.
        fresh : object, optional
            A newly made object of the same kind: it is given the attributes of the saved one,
            keeps its functions, and is returned. Its memory is not written to.

        Raises
        ------
        StateError
            The part is damaged, or not made for the fresh object.
        """
        try:
            return self._value(self._header["parts"][part], fresh)
        except StateError:
            raise
        except (ArithmeticError, AttributeError, ImportError, LookupError, TypeError, ValueError):
            raise StateError(f"{self.path}: is damaged in {part!r}; use an earlier copy") from None

    def _value(self, value: Any, fresh: Any = None) -> Any:
        if not isinstance(value, list):
            return value
        index = value[0]
        if index not in self._made:
            kind, *rest = self._header["nodes"][index]
            self._made[index] = getattr(self, f"_read_{kind}")(index, fresh, *rest)
        return self._made[index]

    def _read_array(
        self,
        index: int,
        fresh: Any,
        which: int,
        dtype: str,
        shape: list[int],
        strides: list[int],
        writeable: bool,
    ) -> NDArray[Any]:
        block, offset = self._header["arrays"][which]
        first, size = self._header["blocks"][block]
        if block not in self._blocks:
            self._blocks[block] = self._memory[first : first + size].copy()
        array: NDArray[Any] = np.ndarray(
            tuple(shape), np.dtype(dtype), self._blocks[block], offset, tuple(strides)
        )
        array.flags.writeable = writeable
        shared = isinstance(fresh, np.ndarray) and fresh.base is not None and array.nbytes < size
        # what others look into, in the file and in the fresh object, cannot change its shape
        if shared and fresh.shape != array.shape:
            self._refuse(f"an array of shape {array.shape} where {fresh.shape} is needed")
        return array

    def _read_objects(
        self, index: int, fresh: Any, shape: list[int], items: list[Any]
    ) -> NDArray[Any]:
        made = self._made[index] = np.empty(shape, dtype=object)
        made.ravel()[:] = self._fill(items, None)
        return made

    def _read_scalar(self, index: int, fresh: Any, array: Any) -> Any:
        return self._value(array)[()]

    def _fill(self, items: list[Any], fresh: Any) -> list[Any]:
        others = list(fresh) if isinstance(fresh, (list, tuple, deque)) else []
        others += [None] * (len(items) - len(others))
        return [self._value(item, other) for item, other in zip(items, others, strict=False)]

    def _read_list(self, index: int, fresh: Any, items: list[Any]) -> list[Any]:
        made = self._made[index] = []
        made += self._fill(items, fresh)
        return made

    def _read_tuple(self, index: int, fresh: Any, items: list[Any]) -> tuple[Any, ...]:
        return tuple(self._fill(items, fresh))

    def _read_set(self, index: int, fresh: Any, items: list[Any]) -> set[Any]:
        return set(self._fill(items, None))

    def _read_frozenset(self, index: int, fresh: Any, items: list[Any]) -> frozenset[Any]:
        return frozenset(self._fill(items, None))

    def _read_deque(
        self, index: int, fresh: Any, items: list[Any], maxlen: int | None
    ) -> deque[Any]:
        made = self._made[index] = deque(maxlen=maxlen)
        made.extend(self._fill(items, fresh))
        return made

    def _read_dict(self, index: int, fresh: Any, pairs: list[Any]) -> dict[Any, Any]:
        made = self._made[index] = {}
        others = fresh if isinstance(fresh, (dict, MappingProxyType)) else {}
        for key, value in pairs:
            name = self._value(key)
            made[name] = self._value(value, others.get(name))
        return made

    def _read_mapping(self, index: int, fresh: Any, pairs: list[Any]) -> MappingProxyType[Any, Any]:
        return MappingProxyType(self._read_dict(index, fresh, pairs))

    def _read_bytes(self, index: int, fresh: Any, text: str) -> bytes:
        return bytes.fromhex(text)

    def _read_path(self, index: int, fresh: Any, text: str) -> Path:
        return Path(text)

    def _read_generator(self, index: int, fresh: Any, state: Any) -> np.random.Generator:
        state = self._value(state)
        kind = getattr(np.random, state["bit_generator"])
        if not issubclass(kind, np.random.BitGenerator):
            raise TypeError(kind)
        bits = kind()
        bits.state = state
        return np.random.Generator(bits)

    def _read_torch(self, index: int, fresh: Any, name: str, weights: Any) -> Any:
        if fresh is None or _name_of(type(fresh)) != name:
            self._refuse(f"a {name} where there is none")
        torch = import_module("torch")
        fresh.load_state_dict({k: torch.from_numpy(v) for k, v in self._value(weights).items()})
        return fresh

    def _read_function(self, index: int, fresh: Any, name: str) -> Any:
        if self.trusted:
            return _found(name)
        if fresh is None or _name_of(fresh) != name:
            self._refuse(f"the function {name} where there is none")
        return fresh

    def _read_named(self, index: int, fresh: Any, name: str, items: list[Any]) -> Any:
        return tuple.__new__(self._class(name, fresh), self._fill(items, fresh))

    def _read_object(self, index: int, fresh: Any, name: str, fields: list[Any]) -> Any:
        kind = self._class(name, fresh)
        other = fresh if type(fresh) is kind else None
        saved = {n for n, _ in fields}
        missing = set(_attributes(other) or ()) - saved
        if missing:
            self._refuse(f"no {', '.join(sorted(missing))} for {name}")
        # what cannot change may belong to others: it is made anew
        made = kind.__new__(kind) if other is None or _frozen(kind) else other
        self._made[index] = made
        for n, value in fields:
            object.__setattr__(made, n, self._value(value, getattr(other, n, None)))
        return made

    def _class(self, name: str, fresh: Any) -> Any:
        """Return a class by name: that of the fresh object, or one of the packages."""
        if _name_of(type(fresh)) == name:
            return type(fresh)
        kind = _found(name) if name.partition(".")[0] in PACKAGES else None
        if not isinstance(kind, type):
            self._refuse(f"the class {name}, which is not known here")
        return kind

    def _refuse(self, what: str) -> NoReturn:
        raise StateError(
            f"{self.path}: was made for another predictor, boat or version of usv-twin "
            f"(it holds {what}); load it with those that it was saved with"
        )


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def _span(array: NDArray[Any]) -> tuple[int, int]:
    """Return the addresses of an array's first byte and of the one after its last."""
    first = _address(array)
    if array.size == 0:
        return first, first
    steps = [step * (n - 1) for step, n in zip(array.strides, array.shape, strict=True)]
    low = first + sum(step for step in steps if step < 0)
    return low, first + sum(step for step in steps if step > 0) + array.itemsize


def _name_of(kind: Any) -> str:
    return f"{getattr(kind, '__module__', None)}:{getattr(kind, '__qualname__', None)}"


def _found(name: str) -> Any:
    """Return what a name of :func:`_name_of` stands for, or None."""
    module, _, path = name.partition(":")
    if module.partition(".")[0] in PACKAGES:
        import_module(module)
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _frozen(kind: type) -> bool:
    parameters = getattr(kind, "__dataclass_params__", None)
    return bool(parameters and parameters.frozen)


def _attributes(value: Any) -> list[str] | None:
    """Return the names of an object's attributes, in slots or not; None if it can have none."""
    slots = [
        name
        for kind in type(value).__mro__
        for name in np.atleast_1d(kind.__dict__.get("__slots__", ())).tolist()
        if name not in ("__dict__", "__weakref__")
    ]
    if not slots and not hasattr(value, "__dict__"):
        return None
    return [n for n in slots if hasattr(value, n)] + list(getattr(value, "__dict__", ()))
