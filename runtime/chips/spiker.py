"""Spiker+ (an accelerator for FPGAs): as large as it is synthesised."""

from runtime.limits import ENDS, WEIGHTS, Limits

VHDL = "Spiker+'s VHDL generator (source read)"

LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "LIF"),
    sources={
        "primitives": f"{VHDL}: a leak by a shift; its other neurons were not read",
        "alone": "one FPGA is synthesised at a time",
    },
)
