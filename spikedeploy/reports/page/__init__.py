"""The page of a comparison: template, style and scripts, which `html` puts into one file.

html        the page
headline    the row that the page is about, and its three numbers
svg         plots that follow the colours of the page
"""
