"""The codec: observations to spikes, and network output to actions.

NumPy float64 is the definition; the torch layers of trainers are tested against it spike by spike.

codec            normaliser, encoder and squashing; ENCODERS is where a new encoder is entered
encoder          the interface of encoders
delta            events when an observation has moved (send-on-delta)
events           counts of an event camera
population       population coding with Gaussian receptive fields
rate             spikes at a rate, evenly spaced or from random bytes
"""
