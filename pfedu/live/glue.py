"""What the chapters use of myst-nb, for a live notebook that does not have it."""

from IPython.display import display as show


def glue(name, variable, display=True):
    """Show a value that the book's text refers to.

    Parameters
    ----------
    name : str
        What the text calls it; there is no text to put it in here.
    variable : object
    display : bool

    Examples
    --------
    >>> from pfedu.live.glue import glue
    >>> glue("n_eff", 43.3)
    43.3
    """
    if display:
        show(variable)
