"""What the compiler makes of a kernel's source, kept from process to process.

Taichi finds a compiled kernel by its intermediate code, so every process has to make that of every kernel anew. To do
so it walks through the source of the kernel and of all functions that the kernel calls: half a second to a second
before a first small sample is solved, with nothing to compile. The walk ends in a few thousand calls of the compiler's
core. Here these calls are written to a file beside the compiled kernels, and repeated in place of the walk the next
time. That takes a tenth of the time and makes the same intermediate code, by which Taichi then finds, or compiles, the
kernel as it does without this module.

A walk is kept only if all that it depends on can be named: the source of this package's kernels, the versions of Python
and of the compiler, the compiler's settings, the arguments, and the values that the kernel takes from the functions
around it. Taichi walks as usual through kernels that call a function from elsewhere, such as a law of one's own; so do
other versions of Taichi, Quadrants, and debug mode, in which errors name lines of the source. Whatever goes wrong while
a walk is kept costs only the file: the kernel is walked all the same.

walk : the calls of the compiler's core by which one kernel becomes intermediate code, or the list of these calls.
core : the compiled part of Taichi. step : one call of a walk, or the making of a list, or the taking of an item.
place : of a value, the number by which the calls of a stored walk refer to it.
"""

import contextlib
import hashlib
import marshal
import sys
import threading
import types
from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter, getitem
from pathlib import Path
from typing import Any

from taichi_bearings.plain_files import replace_file

COMPILER = (1, 7, 4)  # version of Taichi whose inner functions are known here
KERNELS = "taichi_bearings.kernels"  # the package whose functions may be kept
MOST_FILES = 600  # walks in the folder; where there are more, the older half is deleted
# settings of the compiler that no walk depends on; Taichi leaves the second one uninitialised
UNRELATED = "offline_cache_file_path", "print_ir_dbg_info"
# first letters of calls that change nothing: they are kept only if a later call takes what they return
QUERIES = ("get_", "shape", "element_type", "item of")
ASIDE = ("is_", "set_dbg_info", "ast_builder", "get_shape", "get_raw_address", "to_string", "size")
"""First letters of calls that are never written down: they change nothing and return no object of the core."""
SIMPLE = bool, int, float, str, type(None)  # types of Python whose values are stored as they are
COMPILER_MODULES = "taichi.lang."
LIST, ITEM = "list of", "item of"  # names of the steps that are no calls of the core
PLAINLY, KIND, MEMBER = range(3)  # sorts of constants: values of `SIMPLE`; types of numbers; members of enumerations
Walk = tuple[list[str], list[tuple[Any, ...]], list[tuple[int, tuple[int, ...], tuple[str, ...]]]]
"""A stored walk: the names of the functions that it calls, its constants, and its calls. A call is the number of its
function's name, the places of its arguments, and the keywords of the last of these. Places count, from 0, the objects
that every walk begins with, then the constants, then the results of the calls in their order."""
Guard = tuple[str, str, str]
"""The name of a module, a name in that module, and a text about the value that it had when a walk was kept."""


class Unkept(Exception):
    """Raised if a walk is not to be kept on file. A walk is the translation of a kernel's Python source into Taichi's
    intermediate code, as a list of calls of the compiler's core.

    It is raised if a walk depends on something that has no name which is the same in every process, such as a function
    of a user; and for kernels in debug mode or with automatic differentiation.
    """


def keep(compiler: Any, folder: Path, writes: bool) -> None:
    """Have Taichi repeat, from now on, the walks that are kept in a folder. A walk is the sequence of calls of the
    compiler's core by which the source of a kernel becomes intermediate code. Other versions of Taichi are left alone.

    compiler : the module of Taichi, or of Quadrants.
    folder : where the files of walks lie.
    writes : True to keep new walks as well; a process that has to compile everything leaves that to the next one.
    """
    reader = compiler.lang.kernel_impl
    if tuple(compiler.__version__) == COMPILER and not hasattr(reader.Kernel, "walked"):
        kept = _Kept(compiler._lib.core, reader, folder, writes)
        reader.Kernel.walked, reader.Kernel.materialize = reader.Kernel.materialize, kept.materialize()


class _Kept:
    """The walks that one process finds in a folder and adds to it. A walk is the sequence of calls of the compiler's
    core by which the source of a kernel becomes intermediate code.

    core : the compiled module of Taichi.
    reader : the Python module of Taichi that turns the source of kernels into calls of the core.
    folder : where files of walks are stored.
    writes : True if walks that are not stored yet are recorded there.
    """

    def __init__(self, core: Any, reader: Any, folder: Path, writes: bool) -> None:
        """Store the attributes; no walk is read yet."""
        self.core, self.reader, self.folder, self.writes = core, reader, folder, writes
        # `_lock` : held while a walk is made, so that there is one at a time
        # `_settings` : settings of the compiler as texts, by the `id` of Taichi's program
        self._lock, self._settings = threading.Lock(), dict[int, list[str]]()

    def materialize(self) -> Callable[..., None]:
        """Return the function that takes the place of Taichi's method `Kernel.materialize`, which translates a kernel
        into intermediate code. If a walk is stored (the calls of the compiler's core that make up this translation), it
        is repeated; otherwise Taichi translates the kernel, and its calls are stored."""

        def materialized(kernel: Any, key: Any = None, args: Any = None, arg_features: Any = None) -> None:
            """Make the intermediate code of a kernel for some arguments, unless it was made before: from the file of an
            earlier process if there is one, else by Taichi's own translation of its source, which is then stored.

            A walk is this translation, as the list of calls of the compiler's core. `kernel.walked` is Taichi's method;
            `_repeated` uses a file, and `_walked` calls Taichi's method and writes a file.

            kernel : the kernel, `self` of Taichi's method.
            key : key under which Taichi finds the compiled kernel again.
            args : arguments with which the kernel is called.
            arg_features : for each argument what the compiler looks at in it, such as the type of an array.
            """
            kernel.runtime.materialize()
            if key in kernel.compiled_kernels:
                return
            try:
                file = self.folder / self._name(kernel, args, arg_features)
            except Exception:  # what this walk depends on cannot be named
                kernel.walked(key, args, arg_features)
                return
            with self._lock:  # calls of two walks at once would be written down as one
                if not self._repeated(kernel, key, file):
                    self._walked(kernel, (key, args, arg_features), file)

        return materialized

    def _name(self, kernel: Any, args: Any, features: Any) -> str:
        """Return the name of the file for the walk of a kernel with these arguments: a digest of all that the walk
        depends on. A walk is the translation of the kernel's source by calls of the compiler's core.

        args : values of the arguments; those of arguments declared as ti.template() enter.
        features : what the compiler looks at in the other arguments, such as type and number of axes of an array.

        Raises Unkept if something cannot be named, in debug mode, and for kernels with automatic differentiation.
        """
        config, slots = kernel.runtime.prog.config(), set(kernel.template_slot_locations)
        if args is None or features is None or config.debug or kernel.autodiff_mode != self.reader.AutodiffMode.NONE:
            raise Unkept
        templates = [_named(value, ()) for slot, value in enumerate(args) if slot in slots]
        others = [_feature(value) for slot, value in enumerate(features) if slot not in slots]
        if id(kernel.runtime.prog) not in self._settings:
            self._settings[id(kernel.runtime.prog)] = _settings(config)
        settings = self._settings[id(kernel.runtime.prog)]
        inputs = _named(kernel.func, ()), templates, others, _surroundings(), settings
        return f"{hashlib.sha256(repr(inputs).encode()).hexdigest()}.walk"

    def _repeated(self, kernel: Any, key: Any, file: Path) -> bool:
        """Make the intermediate code of a kernel by the walk in a file: repeat the calls of the compiler's core that
        an earlier process recorded. Return False if there is no such file, or none that can be used.

        kernel : the kernel of Taichi.
        key : key under which Taichi finds the compiled kernel again.
        file : path of the file.
        """

        def generator(made: Any) -> None:
            """Fill the new, empty kernel `made` of the core; Taichi calls this."""
            kernel.kernel_cpp = made
            _repeat(self.core, made, kernel.runtime.prog.config(), walk)

        try:
            walk, guards = _read(file)
            if any(_value_at(module, name) != before for module, name, before in guards):
                return False
            title = f"{kernel.func.__name__}_c{kernel.kernel_counter}_{key[1]}"
            made = kernel.runtime.prog.create_kernel(generator, title, kernel.autodiff_mode)
        except Exception:
            return False
        kernel.compiled_kernels[key] = made
        return True

    def _walked(self, kernel: Any, arguments: tuple[Any, ...], file: Path) -> None:
        """Have the compiler walk through a kernel's source, which translates it into intermediate code, and write the
        calls of the core that it makes to a file, if `self.writes`.

        kernel : the kernel of Taichi.
        arguments : the arguments of `Kernel.materialize`: key, arguments of the kernel, and features of these.
        file : path of the file.

        Errors of the walk are raised, as without this module. Errors of writing it down are not: then no file is kept.
        """
        record = None
        with contextlib.ExitStack() as listeners:
            if self.writes:
                with contextlib.suppress(Exception):
                    record = listeners.enter_context(_recording(self.core, self.reader))
            kernel.walked(*arguments)
        if record is not None and not kernel.has_print:
            with contextlib.suppress(Exception):
                _write(file, record.walk(), record.guards())


@contextlib.contextmanager
def _recording(core: Any, reader: Any) -> Iterator["_Record"]:
    """Write down, in the record that is yielded, the calls of the compiler's core that are made inside the block, and
    which functions the compiler reads there.

    core : the compiled part of Taichi.
    reader : the module of Taichi that defines the class of kernels.
    """
    record, before = _Record(core), list[tuple[Any, str, Any]]()

    def put(owner: Any, name: str, value: Any) -> None:
        """Replace the attribute `name` of a module or class (`owner`) by `value`; `before` keeps what it was."""
        before.append((owner, name, vars(owner)[name]))
        setattr(owner, name, value)

    def read(function: Any, *given: Any, **named: Any) -> Any:
        """Do what Taichi's `_get_tree_and_ctx` does, with the same arguments, and note the function whose source it
        reads.
        """
        record.functions.append(function.func)
        return reads(function, *given, **named)

    # functions of the core, and methods of its classes, are replaced by ones that write down their calls
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
    """The calls of the compiler's core that are recorded during one walk through a kernel's source, and how they become
    a walk that can be stored, and repeated without reading the source.

    calls : name, arguments, keyword arguments and result of each call, in their order. All objects are held here, so
        that no two have the same `id`.
    functions : functions whose source the compiler has read.
    """

    def __init__(self, core: Any) -> None:
        """Begin without recorded calls.

        core : the compiled module of Taichi.
        """
        # Where a value comes from is its place: the number, from 0, of the step (call) that returns it, or a negative
        # number for an object that every walk begins with or for a constant. `walk` fills: `_constants`, places by how
        # constants are stored; `_places`, places by the `id` of values; `_steps`, for each call its name, the places of
        # its arguments, and the keywords of the last of these. `_given` has the first objects' places by type.
        self.calls, self.functions = list[tuple[str, tuple[Any, ...], dict[str, Any], Any]](), list[Any]()
        self._core, self._kinds = core, core.DataType
        self._given = {kind: -1 - n for n, kind in enumerate(_given_kinds(core))}
        self._constants, self._places = dict[Any, int](), dict[int, int]()
        self._steps = list[tuple[str, list[int], tuple[str, ...]]]()

    def listening(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does what `function` does and writes down each call under `name`."""

        def heard(*given: Any, **named: Any) -> Any:
            """Call the function with the arguments `given` and `named`, write the call down, and return the result."""
            result = function(*given, **named)
            self.calls.append((name, given, named, result))
            return result

        return heard

    def guards(self) -> list[Guard]:
        """Return the guards of a walk (the recorded calls that translate a kernel), sorted: the names that its
        functions read in their modules, with texts about their values. A stored walk is used only if all of these are
        unchanged.

        Functions of the compiler itself are left out. Raises Unkept if another one is not of this package's kernels.
        """
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
        """Return the recorded calls as a walk that can be stored: names of the functions that are called, constants,
        and calls with numbers that say where their arguments come from. Queries whose results no other call takes are
        left out.

        Raises Unkept if an argument cannot be stored.
        """
        checked, known, given_kinds = set[int](), self._places, self._given
        for name, given, named, result in self.calls:
            if name == "Expr.type_check":  # a second check of an expression changes nothing
                if id(given[0]) in checked:
                    continue
                checked.add(id(given[0]))
            # where each argument comes from; the two usual cases here, the others in `_place`
            places = list[int]()
            for value in (*given, *named.values()) if named else given:
                at = known.get(id(value))
                if at is None:
                    at = given_kinds.get(type(value))
                places.append(self._place(value) if at is None else at)
            self._add_step(name, places, tuple(named), result)
        return self._needed()

    def _needed(self) -> Walk:
        """Return the walk as it is stored: names of the functions that are called, constants, and calls (steps). A step
        is kept if it changes something, or if its result is an argument of a later step that is kept."""
        steps, needed, kept = self._steps, bytearray(len(self._steps)), list[int]()
        # backwards, so that it is known of each query whether a later step that is kept takes its result
        is_query = {name: name.rpartition(".")[2].startswith(QUERIES) for name in {step[0] for step in steps}}
        for number in range(len(steps) - 1, -1, -1):
            if needed[number] or not is_query[steps[number][0]]:
                kept.append(number)
                for at in steps[number][1]:
                    if at >= 0:
                        needed[at] = 1
        kept.reverse()
        # new places, from 0: given objects and constants, which had negative ones, then the results of the kept steps
        begin = len(self._given) + len(self._constants)
        moved = dict(zip(kept, range(begin, begin + len(kept)), strict=True))
        moved |= {-1 - n: n for n in range(begin)}
        names = {name: n for n, name in enumerate(sorted({steps[number][0] for number in kept}))}
        found = [steps[number] for number in kept]
        calls = [(names[name], tuple([moved[at] for at in places]), named) for name, places, named in found]
        return list(names), list(self._constants), calls

    def _add_step(self, name: str, places: list[int], named: tuple[str, ...], result: Any) -> None:
        """Add one step to the walk, the list of calls of Taichi's core that build a kernel, and note under which
        numbers later steps find its result. Objects are recognised by their id; if the result is a list or tuple,
        taking each item is a step of its own.

        name : name of the function that is called.
        places : for each argument the number of the step whose result it is; negative numbers stand for constants and
            given objects.
        named : names of the last len(named) arguments, which are passed by keyword.
        result : what the call returned.
        """
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
        """Return where a value is found when the walk (the list of recorded calls, or steps) is repeated: the number of
        the step whose result it is, or -1, -2, ... for the objects that a walk begins with and then for constants.

        Raises Unkept for an object that is none of these.
        """
        kind = type(value)
        if kind in SIMPLE:
            return self._constant((PLAINLY, value))
        if kind in self._given:
            return self._given[kind]
        if kind is self._kinds and (described := self._described(value)):
            return self._constant(described)
        if id(value) in self._places:
            return self._places[id(value)]
        if kind in (list, tuple):
            self._add_step(LIST, [self._place(item) for item in value], (), value)
            return self._places[id(value)]
        if hasattr(kind, "__members__") and getattr(self._core, kind.__name__, None) is kind:
            return self._constant((MEMBER, kind.__name__, value.name))
        raise Unkept

    def _constant(self, described: tuple[Any, ...]) -> int:
        """Return the place of a constant of the walk, a negative number by which recorded calls refer to it. A constant
        that is seen for the first time gets a new place.

        described : the constant as it is stored: its sort (PLAINLY, KIND or MEMBER), then one or two values that say
            what it is.
        """
        # the text is part of the key: equal numbers of different types, and 0.0 and -0.0, are different constants
        first = -1 - len(self._given)
        return first - self._constants.setdefault((*described, repr(described)), len(self._constants))

    def _described(self, kind: Any) -> tuple[Any, ...] | None:
        """Return what stands for a type in a stored walk: KIND, the name of its number type such as "f64", and its
        shape: () of a number, (n,) of a vector, (n, m) of a matrix. None for other types.

        kind : object of the compiler's core that stands for the type.
        """
        name = kind.to_string()
        if hasattr(self._core, f"DataType_{name}"):
            return KIND, name, ()
        if name.startswith("[Tensor ") and (element := self._described(kind.element_type())):
            return KIND, element[1], tuple(kind.shape())
        return None


def _given_kinds(core: Any) -> list[Any]:
    """Return the types of the objects with which every walk (list of recorded calls of the core) begins, in the order
    in which `_repeat` has them."""
    return [core.DebugInfo, core.CompileConfig, core.Kernel, core.ASTBuilder]


def _repeat(core: Any, kernel: Any, config: Any, walk: Walk) -> None:
    """Repeat a stored walk: make its calls of the compiler's core, which fill an empty kernel with its intermediate
    code.

    core : the compiled part of Taichi.
    kernel : a new, empty kernel of the core.
    config : the compiler's settings.
    walk : what was recorded, as `Walk` describes.
    """
    names, constants, calls = walk
    # values by their place, and functions by the number of their name
    values = [core.DebugInfo(), config, kernel, kernel.ast_builder()]
    values += [_constant_from(core, *described[:-1]) for described in constants]
    tools: list[Any] = [{LIST: _listed, ITEM: getitem}.get(name) or attrgetter(name)(core) for name in names]
    for tool, places, named in calls:
        given = [values[at] for at in places]
        if named:
            begin = len(given) - len(named)
            values.append(tools[tool](*given[:begin], **dict(zip(named, given[begin:], strict=True))))
        else:
            values.append(tools[tool](*given))


def _listed(*values: Any) -> list[Any]:
    """Return the values as a list. In a walk, a list of recorded calls, this is the step `LIST`, which makes one."""
    return list(values)


def _constant_from(core: Any, sort: int, value: Any, more: Any = None) -> Any:
    """Return a constant of a walk (a value that recorded calls of the core take), from how it is stored.

    sort : `PLAINLY`, `KIND` or `MEMBER`.
    value : the constant itself, the name of a type of numbers, or the name of an enumeration.
    more : shape of a vector or matrix, empty for a number, or the name of the member.
    """
    if sort == PLAINLY:
        return value
    if sort == MEMBER:
        return getattr(getattr(core, value), more)
    number = getattr(core, f"DataType_{value}")
    return core.get_type_factory_instance().get_tensor_type(list(more), number) if more else number


def _is_ours(module: str) -> bool:
    """Return True for the name of a module of this package's kernels.

    module : the name.
    """
    return module == KERNELS or module.startswith(f"{KERNELS}.")


def _named(value: Any, above: tuple[int, ...]) -> Any:
    """Return a value that a kernel depends on as lists of numbers and texts, the same in every process.

    above : `id` of the values that contain this one. A value that contains itself is named "above" inside itself.

    Raises Unkept for objects that are not of this package's kernels or of the compiler.
    """
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
    # Functions and objects must come from this package's kernels or the compiler, which do not change in between.
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
    """Return, as a text that JSON can store, something on which a compiled kernel depends in one of its arguments, such
    as the type of its numbers. The text is type and value, such as "bool True", which differs from "int 1".

    value : what the kernel depends on; for a tuple, the result is a list of such texts.
    """
    return [_feature(item) for item in value] if isinstance(value, tuple) else f"{type(value).__name__} {value}"


def _names_in(code: types.CodeType) -> set[str]:
    """Return all names that a function, and the functions inside it, look up in their module or as attributes.

    code : compiled code of the function.
    """
    inner = (item for item in code.co_consts if isinstance(item, types.CodeType))
    return set(code.co_names).union(*map(_names_in, inner))


def _value_at(module: str, name: str) -> str:
    """Return a text about what a module has under a name: the value of a number, text or tuple, else type, module and
    name of the object."""
    value = getattr(sys.modules.get(module), name, None)
    if isinstance(value, (*SIMPLE, tuple)):
        return repr(value)
    return f"{type(value).__name__} {getattr(value, '__module__', '')} {getattr(value, '__qualname__', '')}"


@cache
def _surroundings() -> list[str]:
    """Return the version of Python, and digests of the source of this file and of this package's kernels: walks (the
    recorded translations of kernels) depend on all of these."""
    files = [Path(__file__), *sorted((Path(__file__).parent / "kernels").glob("*.py"))]
    return [sys.version, *(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)]


def _settings(config: Any) -> list[str]:
    """Return a text, name and value, for each setting of the compiler that a walk (the recorded translation of a
    kernel) may depend on.

    config : the settings, an object of the compiler.
    """
    names = [
        name for name, value in vars(type(config)).items() if isinstance(value, property) and name not in UNRELATED
    ]
    return [f"{name} {getattr(config, name)}" for name in names]


def _read(file: Path) -> tuple[Walk, list[Guard]]:
    """Return the walk in a file (the recorded translation of a kernel: names, constants and calls), and its guards:
    names in modules, with texts about the values that they must still have.

    file : path of the file.

    Raises OSError if there is no file, ValueError if it is damaged.
    """
    kept = file.read_bytes()
    if hashlib.sha256(kept[32:]).digest() != kept[:32]:
        raise ValueError(file)
    found: tuple[Walk, list[Guard]] = marshal.loads(kept[32:])
    return found


def _write(file: Path, walk: Walk, guards: list[Guard]) -> None:
    """Write a walk (the recorded translation of a kernel) and its guards (what must be unchanged for it to be used) to
    a file, whole or not at all: another process may write the same file just then.

    file : path of the file.

    Of more than `MOST_FILES` files in the folder the older half is deleted.
    """
    file.parent.mkdir(mode=0o700, exist_ok=True)
    kept = marshal.dumps((walk, guards))
    replace_file(file, hashlib.sha256(kept).digest() + kept)
    files = list(file.parent.iterdir())
    if len(files) > MOST_FILES:
        for old in sorted(files, key=lambda one: one.stat().st_mtime)[: MOST_FILES // 2]:
            old.unlink(missing_ok=True)
