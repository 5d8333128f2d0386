"""Renews setup/hashes.txt: SHA-256 of every file that the package index has of the pinned versions for Linux.

python3 setup/hashes.py asks the index of PEP 691 at PIP_INDEX_URL, or PyPI"s.
"""

import json
import os
import re
import sys
import urllib.request

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, ROOT)

from setup import wheels  # noqa: E402

_HEADER = """\
# SHA-256 of the files that the package index has of each pin for Linux; `python3 setup/hashes.py` renews this list.
# The first call with DRFMCW_HASHES=1 installs these files only.
"""
_PYTHONS = ("py3", "cp311", "cp312", "cp313")


def is_wanted(filename):
    """Whether a wheel is for Linux, or any system, and a Python that drfmcw runs on."""
    python, abi, platform = filename[: -len(".whl")].split("-")[-3:]
    stable = abi == "abi3" and int(re.sub("[^0-9]", "", python)[1:] or 0) <= 13
    fits = stable or (abi in ("none", python) and any(p in python.split(".") for p in _PYTHONS))
    return fits and (platform == "any" or "linux" in platform)


def listed(pin, index):
    """The line of a pin: its requirement and the hashes of its files. Raises OSError where the index gives none."""
    name, version = pin.split("==")
    url = "{}/{}/".format(index.rstrip("/"), re.sub("[-_.]+", "-", name).lower())
    request = urllib.request.Request(url, headers={"Accept": "application/vnd.pypi.simple.v1+json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        files = {f["filename"]: f["hashes"]["sha256"] for f in json.load(answer)["files"]}
    own = re.compile(rf"[^-]+-{re.escape(version)}-.*\.whl$")
    found = [value for file, value in files.items() if own.match(file) and is_wanted(file)]
    if not found:  # built from its source
        source = re.compile(rf".+-{re.escape(version)}(\.tar\.gz|\.zip)$")
        found = [value for file, value in files.items() if source.match(file)]
    if not found:
        raise OSError(f"{url} has no file of {pin}")
    return " ".join([pin, *("--hash=sha256:" + value for value in sorted(found))])


def main():
    """Write the list."""
    index = os.environ.get("PIP_INDEX_URL", "https://pypi.org/simple")
    pins = wheels.read_requirements(ROOT, [wheels.FIRST, *wheels.REQUIREMENTS])
    lines = []
    try:
        for number, pin in enumerate(pins, 1):
            lines.append(listed(pin, index))
            if sys.stderr.isatty():
                print(f"\r{number} of {len(pins)}", end="", file=sys.stderr, flush=True)
    except (OSError, ValueError, KeyError) as error:
        sys.exit(f"{pin}: {error}")
    path = os.path.join(ROOT, wheels.HASHES)
    with open(path + ".new", "w") as file:
        file.write(_HEADER + "\n".join(lines) + "\n")
    os.replace(path + ".new", path)


if __name__ == "__main__":
    main()
