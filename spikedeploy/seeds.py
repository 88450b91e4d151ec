"""Which seeds are for what, so that nothing is ever judged on what it was made with."""

TRAINING = range(5_000)
VALIDATION = range(5_000, 10_000)  # choose checkpoints, record observations for parity
EVALUATION = 10_000  # and everything above
