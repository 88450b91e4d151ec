"""A compiled program as synthesisable Verilog."""
