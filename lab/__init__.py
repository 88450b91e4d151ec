"""Evidence behind the published tables: experiments, benchmarks and comparisons with other tools.

Not installed. Run from a checkout by `python -m lab NAME …` or `./spike lab NAME …`.

experiments  tables of results/ that are filled row by row, and their pages
bench        speed of this code, beside other libraries
firmware     instructions and bytes of exported C, counted in an emulated microcontroller
peers        golden traces and exports recorded with the tools that they come from
interop      our networks opened by other tools, every spike compared
publish      a run as a shipped policy: its file and its card
tables       tables of results/ in README and docs, written anew
walk         the files between a command and its first action or gradient, in order
constraints  the tested versions that `./spike` installs
"""
