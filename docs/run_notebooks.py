"""Run the notebooks and keep what they print and draw: `make notebooks`, after a change that shows in them.

Times and other traces of the machine that ran them are left out, so that only what a reader sees makes a difference.
"""

from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).with_name("notebooks")


def with_few_colours(picture: str) -> str:
    """A picture of a notebook, PNG in base64, in 256 colours: a third of the bytes."""
    image, smaller = Image.open(BytesIO(b64decode(picture))).convert("RGB"), BytesIO()
    image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(smaller, "PNG", optimize=True)
    return b64encode(smaller.getvalue()).decode()


def run(path: Path) -> None:
    book = nbformat.read(path, nbformat.NO_CONVERT)
    with TemporaryDirectory() as folder:
        client = NotebookClient(book, timeout=600, resources={"metadata": {"path": folder}}, record_timing=False)
        client.execute()
    for cell in (cell for cell in book.cells if cell.cell_type == "code"):
        # a line that showed how far a solve was is empty in the end
        cell.outputs = [out for out in cell.outputs if out.get("data") != {"text/plain": ""}]
        for data in (out.data for out in cell.outputs if "image/png" in out.get("data", {})):
            data["image/png"] = with_few_colours(data["image/png"])
    book.metadata["language_info"] = {"name": "python"}
    nbformat.write(book, path)


if __name__ == "__main__":
    for path in sorted(FOLDER.glob("*.ipynb")):
        print(path.name, flush=True)
        run(path)
