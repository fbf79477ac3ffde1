"""Execute notebooks in place, so that committing them again changes no more than it must.

``python -m pfedu.live.execute book/*.ipynb``: pieces of printed text are put together, and the random
name of a widget's model is left out; both would differ at every run.
"""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

WIDGET = "application/vnd.jupyter.widget-view+json"


def execute(path):
    """Execute one notebook and write it back.

    Parameters
    ----------
    path : str or pathlib.Path

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell fails; the file is then left as it was.
    """
    path = Path(path)
    notebook = nbformat.read(path, as_version=4)
    options = dict(record_timing=False, resources={"metadata": {"path": str(path.parent)}})
    NotebookClient(notebook, timeout=600, kernel_name="python3", **options).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = joined(cell.outputs)
            for output in cell.outputs:
                output.get("data", {}).pop(WIDGET, None)
    notebook.metadata.get("language_info", {}).pop("version", None)
    notebook.metadata.pop("widgets", None)  # the state of widgets, full of random names
    nbformat.write(notebook, path)


def joined(outputs):
    """Put neighbouring pieces of one stream together.

    Parameters
    ----------
    outputs : list of nbformat.NotebookNode

    Returns
    -------
    list of nbformat.NotebookNode

    Examples
    --------
    >>> from nbformat.v4 import new_output
    >>> from pfedu.live.execute import joined
    >>> joined([new_output("stream", text="a"), new_output("stream", text="b")])[0].text
    'ab'
    """
    together = []
    for output in outputs:
        last = together[-1] if together else {}
        if output.output_type == "stream" == last.get("output_type") and output.name == last.name:
            last.text += output.text
        else:
            together.append(output)
    return together


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(name, flush=True)
        execute(name)
