"""The page of a comparison: one HTML file that replays recorded episodes.

report      the numbers of a comparison as data, as a page, in Markdown
html        the page: template, style and scripts in one file
svg         plots that follow the colours of the page
"""
