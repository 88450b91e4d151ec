"""SpiNNaker2 (TU Dresden and Manchester, 22 nm): software on 152 cores with a float unit."""

from runtime.limits import ENDS, WEIGHTS, Limits, SynapticMemory

PY = "py-spinnaker2's reading of NIR (source read)"
SURVEY = "secondary: surveys of the chip"

LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Conv2d", "Flatten", "SumPool2d", "Scale", "IF", "LIF", "CubaLIF"),
    cores=152,
    memory=SynapticMemory(size=128 * 1024 * 8, cost="bits", weight_bits=8),
    recurrence=True,
    alone=False,
    sources={
        "primitives": f"{PY}: models lif, lif_curr_exp and lif_conv2d; IF is a lif "
        "without a leak (derived)",
        "cores": SURVEY,
        "memory": f"{SURVEY}: 128 KB of SRAM; program and states lie there too, so the number of "
        "cores is the least that it can be (derived)",
        "recurrence": f"{PY}: a population can hear itself",
        "alone": f"{SURVEY}: chips are joined on boards",
    },
)
