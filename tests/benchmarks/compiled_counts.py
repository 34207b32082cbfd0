"""Operations of a compiled kernel, counted in the program that Taichi's compiler prints before machine code is made.

What no written number depends on does not count: the compiler drops it later. A vector of as many numbers as a block
has sites counts as one operation a site.
"""

import re
from collections import Counter

from taichi_bearings.compiler import ti

ARITHMETIC = ("add", "sub", "mul", "neg", "max", "min", "select")
ROOTS = ("div", "sqrt")
LINE = re.compile(r"\s*(?:<(?P<kind>[^>]*(?:\([^)]*\)[^>]*)?)> )?(?P<name>\$\d+) (?::|=) (?P<rest>.*)")


def printed_program(kernel, arguments, capfd):
    """The last form of the program that calling a fresh kernel prints while it is compiled."""
    settings = ti.lang.impl.current_cfg()
    before = settings.print_ir, settings.offline_cache, settings.print_ir_dbg_info
    settings.print_ir, settings.offline_cache, settings.print_ir_dbg_info = True, False, False
    try:
        capfd.readouterr()
        kernel(*arguments)
    finally:
        settings.print_ir, settings.offline_cache, settings.print_ir_dbg_info = before
    text = capfd.readouterr().out
    return text[text.rindex("\nkernel {") :].splitlines()


def counted(program, block):
    """(operations, roots) a site of a program that goes through one block of sites."""
    lines, constants, loops = [], {}, []
    for line in program:
        found = LINE.match(line)
        if line.strip() == "}" and loops:
            loops.pop()
        if not found:
            continue
        name, rest = found["name"], found["rest"]
        if const := re.match(r"const (-?[\d.e+-]+)", rest):
            constants[name] = float(const[1])
        weight = 1
        for trip in loops:
            weight *= trip
        lines.append((name, found["kind"] or "", rest, weight))
        if rest.endswith("{"):
            bounds = re.search(r"for in range\((\$\d+), (\$\d+)\)", rest)
            known = bounds and bounds[1] in constants and bounds[2] in constants
            loops.append(constants[bounds[2]] - constants[bounds[1]] if known else 1)
    alive, total = needed(lines), Counter()
    for name, kind, rest, weight in lines:
        word = rest.split("(")[0].split()[0] if rest else ""
        if name in alive and re.search(r"f(32|64)", kind) and word in ARITHMETIC + ROOTS:
            sites = 1 if "Tensor" in kind else 1 / block
            total[word in ROOTS] += weight * sites
    return total[False], total[True]


def needed(lines):
    """Names of the statements that a number written to memory depends on."""
    operands = {name: re.findall(r"\$\d+", rest) for name, _, rest, _ in lines}
    writers = {}
    for name, _, rest, _ in lines:
        if stored := re.match(r"local store \[(\$\d+)", rest):
            writers.setdefault(stored[1], []).append(name)
    alive = set()
    waiting = [name for name, _, rest, _ in lines if rest.startswith("global store")]
    while waiting:
        name = waiting.pop()
        if name not in alive:
            alive.add(name)
            waiting += [n for n in operands.get(name, []) + writers.get(name, []) if n not in alive]
            waiting += pieces(name, operands, lines)
    return alive


def pieces(name, operands, lines):
    """Stores to parts of a local vector, where the vector is read as a whole or in part."""
    return [n for n, _, rest, _ in lines if rest.startswith("shift ptr") and name in operands[n][:1]]
