"""Policies of every format behind one interface: found by name, loaded, asked, and priced.

Each format is a module with the functions of `interface.PolicyFormat`; adding one is a file here
and a line in `registry.FORMATS`.

interface    Candidate (before loading), Player (loaded), and the Protocol of a format
registry     the table of formats; find, open_policy and price
costs        spikes, operations and energy of an inference
host_terms   energy of what the host does for a spiking policy
adopted      files of other tools, with a codec beside them, as NIR files of ours
nir          NIR files: spiking policies, on an emulated chip or as their float twin
onnx         ONNX files: float networks, on one thread
teacher      teachers of `distill`: functions of the user, files of other people
native       shared objects of C, which run only where the user says so for the file
run          run folders: the best checkpoint, in torch
run_record   configuration, versions and provenance of a run folder, read without torch
gait         built-in: zero actions, so that the environment's own gait remains
gap          built-in: a script that follows the gap in the LIDAR
random       built-in: uniformly random actions
"""
