"""The NIR graph: what its nodes compute, in which order, on which shapes, and whether it is valid.

The float model and the compiler both start from here, so that they agree on every neuron's
coefficients and every edge's delay.

discretisation   the difference equation of a NIR neuron, the timestep that its gains imply;
                 sigma-delta neurons
shapes           the shapes of every node, windows of convolutions, and the work of a timestep
order            execution order, late edges and delays in timesteps
ports            Input and Output nodes, and their rasters side by side
validate         checks of a whole graph: names, nodes, edges, ports
normal_form      graphs of one level, in floats, without batch axes
"""
