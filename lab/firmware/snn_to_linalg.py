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
    inputs, weights, bias, output, incoming, matrix, outgoing = found.groups()
    kind, is_real = _element(outgoing), _element(outgoing) == "f32"
    zero = f"%zero_{output[1:]}"
    yield f"{zero} = arith.constant {'0.0' if is_real else '0'} : {kind}"
    yield f"linalg.fill ins({zero} : {kind}) outs({output} : {outgoing})"
    product = f"ins({weights}, {inputs} : {matrix}, {incoming}) outs({output} : {outgoing})"
    if is_real:
        yield f"linalg.matvec {product}"
    else:
        yield (
            f'linalg.generic {{indexing_maps = [{_MATRIX}], iterator_types = ["parallel", '
            f'"reduction"]}} {product} {{'
        )
        yield f"""^bb0(%w: {_element(matrix)}, %x: {_element(incoming)}, %sum: {kind}):
%we = arith.extsi %w : {_element(matrix)} to {kind}
%xe = arith.extsi %x : {_element(incoming)} to {kind}
%product = arith.muli %we, %xe : {kind}
%next = arith.addi %sum, %product : {kind}
linalg.yield %next : {kind}
}}"""
    if bias:
        add = "arith.addf" if is_real else "arith.addi"
        body = f"%next = {add} %o0, %i0 : {kind}\nlinalg.yield %next : {kind}"
        yield from _each([(bias, outgoing)], [(output, outgoing)], body)


def _rescale(found: re.Match[str]) -> Iterator[str]:
    inputs, output, own, wanted, incoming, outgoing = found.groups()
    shift, kind = int(wanted) - int(own), _element(outgoing)
    by = "arith.shli" if shift > 0 else "arith.shrsi"
    body = f"""%by = arith.constant {abs(shift)} : {kind}
%next = {by} %i0, %by : {kind}
linalg.yield %next : {kind}"""
    yield from _each([(inputs, incoming)], [(output, outgoing)], body)


def _neurons(found: re.Match[str]) -> Iterator[str]:
    """I = a I + input and V = b V + I, or V = b V + input; above the threshold to 0."""
    name, inputs, states, output, given, types, outgoing = found.groups()
    values = dict(re.findall(r"(\w+) = (\S+) : \w+", given))
    if float(values.get("v_reset_int", 0)) or float(values.get("v_reset_float", 0)):
        raise ValueError("a reset to another membrane than 0 is not translated")
    incoming, *kinds = types.split(", ")
    kind, spike = _element(incoming), _element(outgoing)
    real = kind == "f32"
    end, add = ("float", "arith.addf") if real else ("int", "arith.addi")
    compare = "arith.cmpf ogt" if real else "arith.cmpi sgt"
    zero, one = ("0.0", "1.0") if real else ("0", "1")
    decays = ["cur_decay", "vol_decay"] if name == "cubalif" else ["decay"]
    body, now = "", "%i0"
    for k, decay in enumerate(decays):
        body += _decayed(k, values[f"{decay}_{end}"], real, values.get("d_scale", "0"))
        body += f"\n%n{k} = {add} %d{k}, {now} : {kind}\n"
        now = f"%n{k}"
    kept = ["%n0"] * (len(decays) - 1)
    body += f"""%threshold = arith.constant {values[f"threshold_{end}"]} : {kind}
%above = {compare}, {now}, %threshold : {kind}
%none = arith.constant {zero} : {kind}
%quiet = arith.constant {zero} : {spike}
%fires = arith.constant {one} : {spike}
%left = arith.select %above, %none, {now} : {kind}
%spike = arith.select %above, %fires, %quiet : {spike}
linalg.yield {", ".join([*kept, "%left", "%spike"])} : {f"{kind}, " * len(decays)}{spike}"""
    outputs = [*zip(states.split(", "), kinds, strict=True), (output, outgoing)]
    yield from _each([(inputs, incoming)], outputs, body)


def _decayed(k: int, value: str, real: bool, scale: str) -> str:
    """%dk, the state %ok times its decay factor; in integers by 64 bits, as Q12."""
    if real:
        return f"%f{k} = arith.constant {value} : f32\n%d{k} = arith.mulf %f{k}, %o{k} : f32"
    return f"""%f{k} = arith.constant {value} : i64
%e{k} = arith.extsi %o{k} : i32 to i64
%p{k} = arith.muli %f{k}, %e{k} : i64
%s{k} = arith.constant {scale} : i64
%r{k} = arith.shrsi %p{k}, %s{k} : i64
%d{k} = arith.trunci %r{k} : i64 to i32"""


def _each(ins: list[tuple[str, str]], outs: list[tuple[str, str]], body: str) -> Iterator[str]:
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
    yield body
    yield "}"


def _element(memref: str) -> str:
    """Type of the elements: f32 of memref<64xf32>."""
    return memref.rstrip(">").rpartition("x")[2]
