"""Reports: tables, plots and pages of what was compared.

card             The card of a shipped policy, as a page for people
check_tables     What people read of a check: rules by chips, or one chip's layers and rules
columns          The tables of a comparison, the same ones on the terminal, in the HTML report
curves           Learning curves: what a run's metrics say about its returns
datasheets       Datasheets side by side: what the chips compute with, and what that was compar
drift_tables     The tables of a drift, the same on the terminal and in Markdown
plots            Figures of a comparison and of training runs, PNG; drawn without a display
price_list       The price list: every energy table, where its numbers come from, and how sure
report           The report of a comparison: report.json for machines, report.html and report.m
terminal         What people and machines read: tables and JSON on stdout, progress on stderr
"""
