"""The book: `sphinx-build -W notebooks build/book` makes it. Notebooks are shown with the outputs that they hold."""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE / "_book"))

project = "jaxfrf"
author = "The jaxfrf authors"
copyright = author
language = "en"
extensions = ["myst_nb", "sphinx_copybutton", "generated"]
exclude_patterns = ["_book", "**.ipynb_checkpoints"]
nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["fieldlist"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]  # cells with %%writefile
html_theme = "furo"
html_title = "jaxfrf"
html_show_copyright = False
add_module_names = False
toc_object_entries_show_parents = "hide"
