"""Recorded episodes for reports: what robot, network and chip did in each control step.

packed     arrays as text that a page unpacks
scenes     what there is to draw: bodies of MuJoCo, karts on their track
tracks     numbers of the step infos over time
episode    one episode of a player
recorded   the episodes of a report: the float ANN, the spiking network in float and on the chip
"""
