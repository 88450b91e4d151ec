"""Pages: HTML files that need nothing else, in light and dark, on phones and on paper.

page        the file, and what stands on it: numbers, tables, folded sections
svg         drawings of matplotlib in the colours of the page
cores       the cores of a chip, drawn with what a network takes of them
markdown    a page in Markdown as HTML beside it
report      the numbers of a comparison as data, as a page, in Markdown
comparison  the page of a comparison, which replays recorded episodes
design      the page of `check`
drift       the page of `drift`
training    the page of a training run
"""
