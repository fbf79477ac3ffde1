"""Execute notebooks in place, so that committing them again changes no more than it must.

``python -m pfedu.live.execute book/*.ipynb``: pieces of printed text are put together, and the random
name of a widget's model is left out; both would differ at every run.
"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import nbformat
from jupyter_cache import get_cache
from jupyter_cache.base import CacheBundleIn
from jupyter_cache.executors.utils import single_nb_execution
from nbclient import NotebookClient

WIDGET = "application/vnd.jupyter.widget-view+json"


def execute_into_cache(paths, folder, workers=None):
    """Execute notebooks side by side, and keep them where the build of the book looks for them.

    A notebook that fails is left out: the build executes it again, and says where it fails.

    Parameters
    ----------
    paths : list of pathlib.Path
    folder : str or pathlib.Path
        A jupyter-cache; notebooks that it holds already are not executed.
    workers : int, optional
        How many at a time; by default one a core, and at most 4.
    """
    cache, wanted = get_cache(folder), []
    for path in paths:
        notebook = nbformat.read(path, as_version=4)
        try:
            cache.match_cache_notebook(notebook)
        except KeyError:
            wanted.append((path, notebook))

    def run(job):
        path, notebook = job
        print(f"executing {path.name}", flush=True)
        return single_nb_execution(notebook, cwd=str(path.parent), timeout=600, allow_errors=False)

    with ThreadPoolExecutor(workers or min(os.cpu_count() or 1, 4)) as pool:
        for (path, notebook), result in zip(wanted, pool.map(run, wanted), strict=True):
            if result.err is None:
                bundle = CacheBundleIn(notebook, str(path), data={"execution_seconds": result.time})
                cache.cache_notebook_bundle(bundle, check_validity=False, overwrite=True)


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
