"""The three operations of snn-mlir that our networks need, in MLIR's own dialects.

snn-mlir does this by `snn-opt --convert-snn-to-linalg`, a program that is in no package. This file
does the same to the text that its Python package writes, after its documentation: loops over all
weights, products of all inputs, states updated in place. --snn-opt of the benchmark takes the
program itself where somebody has built it.
"""

import re
from collections.abc import Iterator

_LINEAR = re.compile(
    r"\s*snn\.linear ins\((%\w+), (%\w+)\)(?: bias\((%\w+) : [^)]*\))? out\((%\w+)\)"
    r"(?: {[^}]*})? : (\S+), (\S+) -> (\S+)"
)
_RESCALE = re.compile(
    r"\s*snn\.rescale ins\((%\w+)\) out\((%\w+)\) {w_scale = (\d+) : i64, d_scale = (\d+) : i64} : "
    r"(\S+) -> (\S+)"
)
_NEURONS = re.compile(
    r"\s*snn\.(lif|cubalif) ins\((%\w+)\) state\(([^)]*)\) out\((%\w+)\) {([^}]*)} : "
    r"(.+) -> (\S+)"
)
_SAME = "affine_map<(d0) -> (d0)>"
_MATRIX = (
    "affine_map<(d0, d1) -> (d0, d1)>, affine_map<(d0, d1) -> (d1)>, affine_map<(d0, d1) -> (d0)>"
)


def lower(text: str) -> str:
    """The module without operations of snn."""
    lines = []
    for line in text.splitlines():
        for pattern, writer in ((_LINEAR, _linear), (_RESCALE, _rescale), (_NEURONS, _neurons)):
            if found := pattern.fullmatch(line):
                lines += writer(found)
                break
        else:
            if " snn." in line:
                raise ValueError(f"an operation that is not translated: {line.strip()[:80]}")
            lines.append(line)
    return "\n".join(lines) + "\n"


def _linear(found: re.Match[str]) -> Iterator[str]:
    inputs, weights, bias, output, *types = found.groups()
    incoming, matrix, outgoing = types
    kind, size = _element(outgoing), outgoing
    zero = f"%zero_{output[1:]}"
    yield f"{zero} = arith.constant {'0.0' if kind == 'f32' else '0'} : {kind}"
    yield f"linalg.fill ins({zero} : {kind}) outs({output} : {size})"
    if kind == "f32":
        yield (
            f"linalg.matvec ins({weights}, {inputs} : {matrix}, {incoming}) "
            f"outs({output} : {outgoing})"
        )
    else:
        kinds = (_element(matrix), _element(incoming), kind)
        yield (
            f'linalg.generic {{indexing_maps = [{_MATRIX}], iterator_types = ["parallel", '
            f'"reduction"]}} ins({weights}, {inputs} : {matrix}, {incoming}) '
            f"outs({output} : {outgoing}) {{"
        )
        yield f"^bb0(%w: {kinds[0]}, %x: {kinds[1]}, %sum: {kind}):"
        yield f"%we = arith.extsi %w : {kinds[0]} to {kind}"
        yield f"%xe = arith.extsi %x : {kinds[1]} to {kind}"
        yield f"%product = arith.muli %we, %xe : {kind}"
        yield f"%next = arith.addi %sum, %product : {kind}"
        yield f"linalg.yield %next : {kind}\n}}"
    if bias:
        add = "arith.addf" if kind == "f32" else "arith.addi"
        body = [f"%next = {add} %o0, %i0 : {kind}", f"linalg.yield %next : {kind}"]
        yield from _each([(bias, outgoing)], [(output, outgoing)], body)


def _rescale(found: re.Match[str]) -> Iterator[str]:
    inputs, output, own, wanted, incoming, outgoing = found.groups()
    shift, kind = int(wanted) - int(own), _element(outgoing)
    by = "arith.shli" if shift > 0 else "arith.shrsi"
    body = [
        f"%by = arith.constant {abs(shift)} : {kind}",
        f"%next = {by} %i0, %by : {kind}",
        f"linalg.yield %next : {kind}",
    ]
    yield from _each([(inputs, incoming)], [(output, outgoing)], body)


def _neurons(found: re.Match[str]) -> Iterator[str]:
    """I = a I + input and V = b V + I, or V = b V + input; above the threshold to 0."""
    name, inputs, states, output, given, types, outgoing = found.groups()
    values = dict(re.findall(r"(\w+) = (\S+) : \w+", given))
    if float(values.get("v_reset_int", 0)) or float(values.get("v_reset_float", 0)):
        raise ValueError("a reset to another membrane than 0 is not translated")
    incoming, *kinds = types.split(", ")
    state = states.split(", ")
    kind, spike = _element(incoming), _element(outgoing)
    real = kind == "f32"
    end = "float" if real else "int"
    decays = ["cur_decay", "vol_decay"] if name == "cubalif" else ["decay"]
    add, body, now = "arith.addf" if real else "arith.addi", [], "%i0"
    for k, decay in enumerate(decays):
        value = values[f"{decay}_{end}"]
        body += _decayed(k, value, kind, values.get("d_scale", "0"))
        body += [f"%n{k} = {add} %d{k}, {now} : {kind}"]
        now = f"%n{k}"
    compare = "arith.cmpf ogt" if real else "arith.cmpi sgt"
    zero, one = ("0.0", "1.0") if real else ("0", "1")
    body += [
        f"%threshold = arith.constant {values[f'threshold_{end}']} : {kind}",
        f"%above = {compare}, {now}, %threshold : {kind}",
        f"%none = arith.constant {zero} : {kind}",
        f"%quiet = arith.constant {zero} : {spike}",
        f"%fires = arith.constant {one} : {spike}",
        f"%left = arith.select %above, %none, {now} : {kind}",
        f"%spike = arith.select %above, %fires, %quiet : {spike}",
    ]
    kept = ["%n0"] * (len(decays) - 1)
    names = ", ".join([*kept, "%left", "%spike"])
    body.append(f"linalg.yield {names} : {', '.join([kind] * len(decays) + [spike])}")
    outputs = [*zip(state, kinds, strict=True), (output, outgoing)]
    yield from _each([(inputs, incoming)], outputs, body)


def _decayed(k: int, value: str, kind: str, scale: str) -> list[str]:
    """%dk, the state %ok times its decay factor; in integers by 64 bits, as Q12."""
    if kind == "f32":
        return [f"%f{k} = arith.constant {value} : f32", f"%d{k} = arith.mulf %f{k}, %o{k} : f32"]
    return [
        f"%f{k} = arith.constant {value} : i64",
        f"%e{k} = arith.extsi %o{k} : i32 to i64",
        f"%p{k} = arith.muli %f{k}, %e{k} : i64",
        f"%s{k} = arith.constant {scale} : i64",
        f"%r{k} = arith.shrsi %p{k}, %s{k} : i64",
        f"%d{k} = arith.trunci %r{k} : i64 to i32",
    ]


def _each(
    ins: list[tuple[str, str]], outs: list[tuple[str, str]], body: list[str]
) -> Iterator[str]:
    """A body for each element: %i0 … of what is read, %o0 … of what is written."""
    maps = ", ".join([_SAME] * (len(ins) + len(outs)))
    words = [
        f"{word}({', '.join(n for n, _ in pairs)} : {', '.join(t for _, t in pairs)})"
        for word, pairs in (("ins", ins), ("outs", outs))
    ]
    yield (
        f'linalg.generic {{indexing_maps = [{maps}], iterator_types = ["parallel"]}} '
        f"{' '.join(words)} {{"
    )
    names = [f"%i{k}: {_element(t)}" for k, (_, t) in enumerate(ins)]
    names += [f"%o{k}: {_element(t)}" for k, (_, t) in enumerate(outs)]
    yield f"^bb0({', '.join(names)}):"
    yield from body
    yield "}"


def _element(memref: str) -> str:
    """Type of the elements: f32 of memref<64xf32>."""
    return memref.rstrip(">").rpartition("x")[2]
