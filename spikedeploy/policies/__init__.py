"""Policies of every format behind one interface: found by name, loaded, and priced.

Each format is a subclass of `registry.Controller`; adding one is a class here and a line in
`registry.FORMATS`.

registry     Candidate (before loading), Entry (on a chip, with a setup), Controller (loaded);
             find and open_policy
costs        spikes, operations and energy of an inference
nir          NIR files: spiking policies, on an emulated chip or as their float twin
onnx         ONNX files: float networks, on one thread
native       shared objects of C, which run only where the user permits the file

run_record   configuration, versions and provenance of a run folder, read without torch
scripts      the built-in gait, random and gap; teachers of `distill`
"""
