"""The float twin: a NIR graph computed in floating point.

graph            The float twin: a NIR graph computed in floating point, as its convention says
nodes            What each kind of NIR node does to its input, in floating point
spatial          Convolutions and pools in floating point: windows of the input, all in one pro
"""
