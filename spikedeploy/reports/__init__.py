"""Reports: tables, figures and pages of what comparison, emulation and training found.

Nothing is computed here that is not in the data; the same tables serve terminal, page and Markdown.

table       a table and its forms: terminal, Markdown, HTML, CSV
columns     the tables of a comparison, the short table; one line
summary     the result in sentences, energy too; the row that a page is about, and its numbers
plots       figures by matplotlib: returns, energies, learning curves, spikes; as PNG and SVG
page        pages by jinja2, from `templates` and `assets`; Markdown as a page; HTML in notebooks

comparison_page  report.json, report.html and report.md of a comparison
design           a network against the design rules: by chip, by layer, by rule, core by core
drift_page       drift by layer and by rounding
network_runs     runs in open loop, over rasters and recordings of event cameras
runs             training runs: scores, list, page
datasheets       chips, energy tables, break-even lines, shipped policies
terminal         what commands print of comparisons, emulations, files and traces
"""
