"""Exporters: a trained policy or a compiled program in, files out; and checks that both agree.

The table of formats is spikedeploy.shipping.export.EXPORTERS.

to_nir        a spiking policy as `.nir`
to_onnx       a float policy as `.onnx`; a spiking one by spiking_onnx
spiking_onnx  a spiking policy as one step in ONNX, states in and out
onnx_graph    graphs of ONNX written as formulas
parity        a written file against its policy: NIR spike by spike, ONNX action by action
check         a line of a parity report, and its counters
to_program    a compiled program as plain files, and what is expected of a chip; takes no torch
rendering     texts from templates
kit/          scripts for the chips' tools, copied as they are, and imported by nothing
to_xylo       a compiled program as Rockpool's specification, a part of the kit
c/            a compiled program as C99 for microcontrollers; takes no torch
verilog/      a compiled program as Verilog for FPGAs; takes no torch
"""
