"""The same network in the scaling that another tool's import of NIR accepts.

Importers fix dt and gains, and ignore or refuse what they do not expect: snnTorch 1.0.0 takes a
CubaLIF with r = tau_mem/dt at dt = 0.1 ms only, Norse ignores r of a LIF. The difference equation
(runtime.graph.neurons) leaves a choice that they do not see. With s > 0 for each neuron,

    V' = s V,  threshold' = s threshold,  v_reset' = s v_reset,  leak' = s leak
    W' = W s gain / gain of the tool

has the same spikes, and tau' = dt'/(1 - decay) gives the same decay factors at the dt of the tool.

rewritten    the table of importers, and an artifact as one of them reads it, checked
neurons      a layer's neurons, and the weights before it
visits       names and edges in an order in which importers run the nodes as NIR means
"""
