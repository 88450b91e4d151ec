"""Faults of chips: parts of a program that are broken, and upsets while it runs.

`injected(program, faults("dead-neurons:2"))` is the program on a faulty chip. Which parts are hit
is drawn from the specimen, a number: another specimen is another chip with as many faults. A new
fault is a function in a module and a line in FAULTS.

fault        what a kind of fault is
request      `name:level` and `name=number`, read
injection    a program with faults, and what they hit
neurons      dead neurons, and thresholds that differ
weights      weights that are stuck, or have a flipped bit
upsets       lost and spurious spikes, flipped bits of membranes
"""

_HERE = "spikedeploy.runtime.faults"
FAULTS: dict[str, str] = {
    "dead-neurons": f"{_HERE}.neurons:DEAD_NEURONS",
    "threshold-mismatch": f"{_HERE}.neurons:THRESHOLD_MISMATCH",
    "stuck-zero": f"{_HERE}.weights:STUCK_ZERO",
    "stuck-max": f"{_HERE}.weights:STUCK_MAX",
    "weight-flips": f"{_HERE}.weights:WEIGHT_FLIPS",
    "state-flips": f"{_HERE}.upsets:STATE_FLIPS",
    "lost-spikes": f"{_HERE}.upsets:LOST_SPIKES",
    "spurious-spikes": f"{_HERE}.upsets:SPURIOUS_SPIKES",
}
