"""The emulator: a program running, its ledger, and the controllers that drive a robot with it.

backend          the interface of what computes a program, and the choice
interpreter      the arithmetic of the chips as its specification, in chip time; upsets
ledger           counted events of a chip, so that any table of energies can price them
machine          a chip with a program on it, running, and its host
running_network  a network on a chip or in float: the one place that decides
controllers      a policy file acting on a robot, on a chip or in float

Who steps what: a SpikingController encodes, lets its network infer, and decodes. A Machine gives
the rows of an inference, or one timestep, to a Backend. The interpreter calls the arithmetic's
update for one layer and timestep after another; for Loihi that adds up the weights of spikes in
families.cuba.neurons.sum_arriving. Spikes become operations in ledger.count_events. That is the
specification. By default Numba adds and counts, families.numba_frame.sum_weights and _count; or,
where it is missing, NumPy adds: families.cuba.numpy_backend.Summation.
"""
