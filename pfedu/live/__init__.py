"""Hosts for explorers: Jupyter (``jupyter``), the page's worker (``browser``), and the built page (``page``)."""


def explore(explorer, **start):
    """Show an explorer.

    In Jupyter it is live at once. In the built book the same cell becomes a figure that is drawn
    beforehand and redrawn by Python in the reader's browser. An explorer that is made in the notebook
    is live in Jupyter only; the built book shows its picture, for the page's Python knows no notebook.

    Parameters
    ----------
    explorer : str or pfedu.explorers.Explorer
        Name of a file in ``pfedu/explorers``, or an explorer made in the notebook.
    **start
        Where controls start, if not at their defaults.

    Returns
    -------
    pfedu.live.jupyter.JupyterExplorer

    Raises
    ------
    ValueError
        If there is no such explorer, control or position.

    Examples
    --------
    >>> from pfedu.live import explore
    >>> explore("sir", N=100)
    explore('sir', N=100)
    """
    from pfedu.live.jupyter import JupyterExplorer

    return JupyterExplorer(explorer, **start)
