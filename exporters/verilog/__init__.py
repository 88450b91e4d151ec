"""A compiled program of CuBa-LIF neurons as Verilog for an FPGA with open tools.

The core is the same Verilog for every program; what differs is in its parameters and memories.

to_verilog    files of a core: policy_core.v, its parameters, the contents of its memories
image         contents of the memories and widths of the registers, from a program's integers
bench         contents of the self-checking bench: what the emulator computes
simulation    the core in Verilator as a process
refusals      programs that the core does not compute, by the name of a rule
boards        FPGA, clock and pins of boards; boards.toml
resources     cells and memories that a core takes, predicted
board_files   files around a core on a board: top module, UART, constraints, Makefile, host
eda_tools     programs that build and simulate, found automatically
templates/    policy_core.v, bench.v, sim_main.cpp: the core and its simulation; uart.v, link.v,
              top.v: its way to a host; host.py and link.py: the host; Makefile, *.py around them
"""
