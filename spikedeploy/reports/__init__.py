"""Reports: tables and plots of what comparison, emulation and training found.

Nothing is computed here that is not in the data; the same tables serve terminal, HTML and Markdown.

cells         one column of a table, and how its cells are written
energy_columns  the columns about energy: by every table, and where it goes
columns       the tables of a comparison, column by column
short_table   a comparison in one table of 80 columns, a run in one line
headline      the row that a page is about, and three numbers of it
markdown      lines of a table in Markdown
csv_rows      rows as CSV, and read again
plots         returns, energies and learning curves as PNG
curves        the learning curve in a run's metrics
terminal      what commands print of comparisons, emulations, drifts, files and traces
check_tables  a network against the design rules: by chip, by layer, by rule
drift_tables  drift by layer and by rounding
entries       one chip, energy table or policy in full
notebook      HTML that notebooks show
listings      the chips side by side; the energy tables; the break-even lines
"""
