"""The site of the manual: `sphinx-build -aEW --keep-going docs site`, with the extra `docs`."""

project = "leactl"
author = "the leactl contributors"
extensions = ["myst_parser"]
myst_heading_anchors = 3  # links to headings, as the pages write them, are checked
html_theme = "furo"
html_title = "leactl"
html_show_sourcelink = False
html_show_copyright = False
