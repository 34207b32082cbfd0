"""What the compiler makes of a kernel's source, kept from process to process.

Taichi finds a compiled kernel by its intermediate code, so every process has to make that of every kernel anew, and
walks through the source of the kernel and of all functions it calls: half a second to a second before a first small
sample is solved, with nothing to compile. The walk ends in a few thousand calls of the compiler's core. Here these are
written down in a file beside the compiled kernels, and made in place of the walk the next time: that takes a tenth of
the time and makes the same intermediate code, by which Taichi then finds, or compiles, the kernel as ever.

A walk is kept only if all that it depends on can be named: the source of this package's kernels, the versions of Python
and of the compiler, its settings, the arguments, and the values that enclose the kernel. Kernels that call a function
from elsewhere, such as a law of one's own, are walked as ever; so is everything by other versions of the compiler, by
Quadrants, and in debug mode, where errors name lines of the source.
"""

import contextlib
import hashlib
import marshal
import os
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter, getitem
from pathlib import Path
from typing import Any

COMPILER = (1, 7, 4)  # version of Taichi whose inner functions are known here
KERNELS = "taichi_bearings.kernels"  # the package whose functions may be kept
MOST_FILES = 600  # in the folder; beyond, the half that was written first goes
UNRELATED = ("offline_cache_file_path",)  # settings of the compiler that no walk depends on
# calls of the core that leave nothing behind but what they find, and those of them that find no object of the core
QUERIES = ("get_", "shape", "element_type", "item of")
ASIDE = ("is_", "set_dbg_info", "ast_builder", "get_shape", "get_raw_address", "to_string", "size")
SIMPLE = bool, int, float, str, type(None)
COMPILER_MODULES = "taichi.lang."
LIST, ITEM = "list of", "item of"  # steps of a walk that are no calls of the core
PLAINLY, KIND, MEMBER = range(3)  # sorts of constants: what Python knows; types of numbers; members of enumerations
Walk = tuple[list[str], list[tuple], list[tuple[int, tuple[int, ...], tuple[str, ...]]]]
"""Names of what is called; constants; calls: number of the name, which values, the names of the last of them. Values
are those that a walk begins with, constants, and results of the calls before."""
Guard = tuple[str, str, str]
"""A module, a name in it, and what stood there when a walk was kept."""


class Unkept(Exception):
    """A walk depends on something that cannot be named, so that it is not kept."""


def keep(compiler: Any, folder: Path, writes: bool) -> None:
    """From now on repeat walks that are kept in this folder. compiler : Taichi. writes : keep new ones; a process that
    has to compile everything leaves that to the next. Nothing happens if Taichi's inner functions are others."""
    reader = compiler.lang.kernel_impl
    if tuple(compiler.__version__) == COMPILER and not hasattr(reader.Kernel, "walked"):
        kept = _Kept(compiler._lib.core, reader, folder, writes)
        reader.Kernel.walked, reader.Kernel.materialize = reader.Kernel.materialize, kept.materialize()


class _Kept:
    """The walks of one process. core : the compiled part of Taichi. reader : the module that holds its kernels."""

    def __init__(self, core: Any, reader: Any, folder: Path, writes: bool) -> None:
        self.core, self.reader, self.folder, self.writes = core, reader, folder, writes
        self._lock, self._settings = threading.Lock(), dict[int, list[str]]()

    def materialize(self) -> Callable:
        """What takes the place of the method of Taichi's kernels that has this name."""

        def materialized(kernel: Any, key: Any = None, args: Any = None, arg_features: Any = None) -> None:
            kernel.runtime.materialize()
            if key in kernel.compiled_kernels:
                return
            try:
                place = self.folder / self._name(kernel, args, arg_features)
            except Unkept:
                kernel.walked(key, args, arg_features)
                return
            with self._lock:  # a walk that is written down is alone
                if not self._repeated(kernel, key, place):
                    self._walked(kernel, (key, args, arg_features), place)

        return materialized

    def _name(self, kernel: Any, args: Any, features: Any) -> str:
        """A name for the walk of a kernel with these arguments: a digest of all it depends on. Raises Unkept."""
        config, slots = kernel.runtime.prog.config(), set(kernel.template_slot_locations)
        if args is None or features is None or config.debug or kernel.autodiff_mode != self.reader.AutodiffMode.NONE:
            raise Unkept
        templates = [_named(value, ()) for slot, value in enumerate(args) if slot in slots]
        others = [_feature(value) for slot, value in enumerate(features) if slot not in slots]
        if id(kernel.runtime.prog) not in self._settings:
            self._settings[id(kernel.runtime.prog)] = _settings(config)
        settings = self._settings[id(kernel.runtime.prog)]
        told = _named(kernel.func, ()), templates, others, _surroundings(), settings
        return f"{hashlib.sha256(repr(told).encode()).hexdigest()}.walk"

    def _repeated(self, kernel: Any, key: Any, place: Path) -> bool:
        """Make the intermediate code of a kernel by a walk that was kept; False if there is none that can be used."""

        def generator(made: Any) -> None:
            kernel.kernel_cpp = made
            _repeat(self.core, made, kernel.runtime.prog.config(), walk)

        try:
            walk, guards = _read(place)
            if any(_value_at(module, name) != told for module, name, told in guards):
                return False
            title = f"{kernel.func.__name__}_c{kernel.kernel_counter}_{key[1]}"
            made = kernel.runtime.prog.create_kernel(generator, title, kernel.autodiff_mode)
        except Exception:
            return False
        kernel.compiled_kernels[key] = made
        return True

    def _walked(self, kernel: Any, wishes: tuple, place: Path) -> None:
        """Have the compiler walk through a kernel, and keep what it did."""
        if not self.writes:
            kernel.walked(*wishes)
            return
        with _recording(self.core, self.reader) as record:
            kernel.walked(*wishes)
        with contextlib.suppress(Unkept, OSError):
            if not kernel.has_print:
                _write(place, record.walk(), record.guards())


@contextlib.contextmanager
def _recording(core: Any, reader: Any) -> Iterator["_Record"]:
    """Write down the calls of the core that are made inside the block, and which functions the compiler reads."""
    record, before = _Record(core), list[tuple[Any, str, Any]]()

    def put(owner: Any, name: str, value: Any) -> None:
        before.append((owner, name, vars(owner)[name]))
        setattr(owner, name, value)

    def read(function: Any, *given: Any, **named: Any) -> Any:
        record.functions.append(function.func)
        return reads(function, *given, **named)

    reads = reader._get_tree_and_ctx
    try:
        put(reader, "_get_tree_and_ctx", read)
        for owner in (core.ASTBuilder, core.Kernel, core.Expr, core.ExprGroup, core.DataType):
            for name, value in list(vars(owner).items()):
                if type(value).__name__ == "instancemethod" and not name.startswith(("__", *ASIDE)):
                    put(owner, name, record.listening(f"{owner.__name__}.{name}", value.__func__))
        for name, value in list(vars(core).items()):
            if value is core.ExprGroup or (isinstance(value, types.BuiltinFunctionType) and not name.startswith(ASIDE)):
                put(core, name, record.listening(name, value))
        yield record
    finally:
        for owner, name, value in reversed(before):
            setattr(owner, name, value)


class _Record:
    """Calls of the compiler's core in their order: name, whether it is a method, arguments, named ones, result. All of
    them are held, so that each has a number of its own. functions : that the compiler has read."""

    def __init__(self, core: Any) -> None:
        self.calls, self.functions = list[tuple[str, tuple, dict, Any]](), list[Any]()
        self._core, self._kinds = core, core.DataType
        self._given = {kind: -1 - n for n, kind in enumerate(_given_kinds(core))}
        self._constants, self._places = dict[Any, int](), dict[int, int]()
        self._steps = list[tuple[str, list[int], tuple]]()

    def listening(self, name: str, function: Callable) -> Callable:
        """The same function; its calls are written down under this name."""

        def heard(*given: Any, **named: Any) -> Any:
            result = function(*given, **named)
            self.calls.append((name, given, named, result))
            return result

        return heard

    def guards(self) -> list[Guard]:
        """What the functions read from their modules. Raises Unkept if one of them is not of this package."""
        found = set()
        for function in self.functions:
            module = function.__module__
            if module.startswith(COMPILER_MODULES):
                continue
            if not _is_ours(module):
                raise Unkept
            names = _names_in(function.__code__) & function.__globals__.keys()
            found |= {(module, name, _value_at(module, name)) for name in names}
        return sorted(found)

    def walk(self) -> Walk:
        """The same calls, but for those that only look at what nobody needs. Raises Unkept."""
        checked, known, given_kinds = set[int](), self._places, self._given
        for name, given, named, result in self.calls:
            if name == "Expr.type_check":  # once is enough for each expression
                if id(given[0]) in checked:
                    continue
                checked.add(id(given[0]))
            places = list[int]()
            for value in (*given, *named.values()) if named else given:
                at = known.get(id(value))
                if at is None:
                    at = given_kinds.get(type(value))
                places.append(self._place(value) if at is None else at)
            self._note(name, places, tuple(named), result)
        return self._needed()

    def _needed(self) -> Walk:
        """The steps that leave something behind, or that one of these needs."""
        steps, needed, kept = self._steps, bytearray(len(self._steps)), list[int]()
        looks = {name: name.rpartition(".")[2].startswith(QUERIES) for name in {step[0] for step in steps}}
        for number in range(len(steps) - 1, -1, -1):
            if needed[number] or not looks[steps[number][0]]:
                kept.append(number)
                for at in steps[number][1]:
                    if at >= 0:
                        needed[at] = 1
        kept.reverse()
        begin = len(self._given) + len(self._constants)
        moved = dict(zip(kept, range(begin, begin + len(kept)), strict=True))
        moved |= {-1 - n: n for n in range(begin)}
        names = {name: n for n, name in enumerate(sorted({steps[number][0] for number in kept}))}
        found = [steps[number] for number in kept]
        calls = [(names[name], tuple([moved[at] for at in places]), named) for name, places, named in found]
        return list(names), list(self._constants), calls

    def _note(self, name: str, places: list[int], named: tuple, result: Any) -> None:
        """Write down one step, whose result later ones may take."""
        number = len(self._steps)
        self._steps.append((name, places, named))
        if type(result) in SIMPLE:
            return
        self._places[id(result)] = number
        if isinstance(result, (list, tuple)) and name != LIST:
            for n, item in enumerate(result):
                if type(item) not in SIMPLE:
                    self._places[id(item)] = len(self._steps)
                    self._steps.append((ITEM, [number, self._constant((PLAINLY, n))], ()))

    def _place(self, value: Any) -> int:
        """Where a value is found when the walk is repeated: the number of the step whose result it is, or -1, -2, ...
        for what a walk begins with and then for constants. Raises Unkept."""
        kind = type(value)
        if kind in SIMPLE:
            return self._constant((PLAINLY, value))
        if kind in self._given:
            return self._given[kind]
        if kind is self._kinds and (told := self._kind(value)):
            return self._constant(told)
        if id(value) in self._places:
            return self._places[id(value)]
        if kind in (list, tuple):
            self._note(LIST, [self._place(item) for item in value], (), value)
            return self._places[id(value)]
        if hasattr(kind, "__members__") and getattr(self._core, kind.__name__, None) is kind:
            return self._constant((MEMBER, kind.__name__, value.name))
        raise Unkept

    def _constant(self, told: tuple) -> int:
        """Equal numbers of different types, and the two zeros, are different constants."""
        first = -1 - len(self._given)
        return first - self._constants.setdefault((*told, repr(told)), len(self._constants))

    def _kind(self, kind: Any) -> tuple | None:
        """What says which type of numbers this is, or of vectors and matrices of them; None of others."""
        told = kind.to_string()
        if hasattr(self._core, f"DataType_{told}"):
            return KIND, told, ()
        if told.startswith("[Tensor ") and (element := self._kind(kind.element_type())):
            return KIND, element[1], tuple(kind.shape())
        return None


def _given_kinds(core: Any) -> list[Any]:
    """Of the objects that a walk begins with."""
    return [core.DebugInfo, core.CompileConfig, core.Kernel, core.ASTBuilder]


def _repeat(core: Any, kernel: Any, config: Any, walk: Walk) -> None:
    """Make the calls of a walk. kernel : a new one of the core."""
    names, constants, calls = walk
    values = [core.DebugInfo(), config, kernel, kernel.ast_builder()]
    values += [_made(core, *told[:-1]) for told in constants]
    tools: list[Any] = [{LIST: _listed, ITEM: getitem}.get(name) or attrgetter(name)(core) for name in names]
    for tool, places, named in calls:
        given = [values[at] for at in places]
        if named:
            begin = len(given) - len(named)
            values.append(tools[tool](*given[:begin], **dict(zip(named, given[begin:], strict=True))))
        else:
            values.append(tools[tool](*given))


def _listed(*values: Any) -> list:
    return list(values)


def _made(core: Any, sort: int, value: Any, more: Any = None) -> Any:
    """A constant of a walk."""
    if sort == PLAINLY:
        return value
    if sort == MEMBER:
        return getattr(getattr(core, value), more)
    number = getattr(core, f"DataType_{value}")
    return core.get_type_factory_instance().get_tensor_type(list(more), number) if more else number


def _is_ours(module: str) -> bool:
    return module == KERNELS or module.startswith(f"{KERNELS}.")


def _named(value: Any, above: tuple) -> Any:
    """A value that encloses a kernel as numbers and texts, the same in every process. Raises Unkept."""
    if type(value) in SIMPLE:
        return value
    if isinstance(value, types.ModuleType):
        return value.__name__
    inside = (*above, id(value))
    if id(value) in above:
        return "above"
    if isinstance(value, (tuple, list)):
        return [type(value).__name__, *(_named(item, inside) for item in value)]
    if isinstance(value, dict):
        return ["dict", *((_named(k, inside), _named(item, inside)) for k, item in value.items())]
    if isinstance(value, types.FunctionType):
        if not (_is_ours(value.__module__) or value.__module__.startswith("taichi.lang.")):
            raise Unkept
        cells = [_named(cell.cell_contents, inside) for cell in value.__closure__ or ()]
        return [value.__module__, value.__qualname__, cells]
    kind = type(value)
    if kind.__module__ == "taichi.lang.kernel_impl":
        return [kind.__name__, _named(value.func, inside)]
    if not _is_ours(kind.__module__):
        raise Unkept
    return [kind.__module__, kind.__qualname__, _named(vars(value), inside)]


def _feature(value: Any) -> Any:
    """What the compiler looks at in an argument, as text."""
    return [_feature(item) for item in value] if isinstance(value, tuple) else f"{type(value).__name__} {value}"


def _names_in(code: types.CodeType) -> set[str]:
    """All names that a function and those inside it look up in their module."""
    inner = (item for item in code.co_consts if isinstance(item, types.CodeType))
    return set(code.co_names).union(*map(_names_in, inner))


def _value_at(module: str, name: str) -> str:
    """A number or text as it stands in a module; of others what they are called."""
    value = getattr(sys.modules.get(module), name, None)
    if isinstance(value, (*SIMPLE, tuple)):
        return repr(value)
    return f"{type(value).__name__} {getattr(value, '__module__', '')} {getattr(value, '__qualname__', '')}"


@cache
def _surroundings() -> list[str]:
    """Digests of this package's kernels and of this file, and the version of Python."""
    files = [Path(__file__), *sorted((Path(__file__).parent / "kernels").glob("*.py"))]
    return [sys.version, *(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)]


def _settings(config: Any) -> list[str]:
    """The settings of the compiler."""
    names = [
        name for name, value in vars(type(config)).items() if isinstance(value, property) and name not in UNRELATED
    ]
    return [f"{name} {getattr(config, name)}" for name in names]


def _read(place: Path) -> tuple[Walk, list[Guard]]:
    """A walk that was kept. Raises OSError if there is none, ValueError if it is damaged."""
    kept = place.read_bytes()
    if hashlib.sha256(kept[32:]).digest() != kept[:32]:
        raise ValueError(place)
    return marshal.loads(kept[32:])


def _write(place: Path, walk: Walk, guards: list[Guard]) -> None:
    """Keep a walk; another process may do the same at the same time."""
    place.parent.mkdir(mode=0o700, exist_ok=True)
    kept = marshal.dumps((walk, guards))
    handle, name = tempfile.mkstemp(dir=place.parent)
    with os.fdopen(handle, "wb") as file:
        file.write(hashlib.sha256(kept).digest() + kept)
    os.replace(name, place)
    files = list(place.parent.iterdir())
    if len(files) > MOST_FILES:
        for old in sorted(files, key=lambda file: file.stat().st_mtime)[: MOST_FILES // 2]:
            old.unlink(missing_ok=True)
