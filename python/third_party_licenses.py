"""Writes LICENSE-THIRD-PARTY: the licences of all Rust crates that the wheel contains, and of the C code in them.

python python/third_party_licenses.py [--check]
python python/third_party_licenses.py --package snake-keypoints --output FILE    # those of the program

A crate that may be used under the Apache License 2.0 is used under it; its text stands once. Of the others all texts of their packages
are taken. With --check the file is compared and not written.
"""

import argparse
import json
import re
import subprocess
from pathlib import Path

FOLDER = Path(__file__).parent
OUTPUT = FOLDER / "LICENSE-THIRD-PARTY"
WHEEL = "snake-rs-python"
TEXTS = re.compile(r"^(LICEN[CS]E|COPYING|COPYRIGHT|NOTICE|UNLICENSE)", re.IGNORECASE)
RULE = "=" * 80


def crates(package: str) -> list[dict[str, str]]:
    """The crates in the wheel or in a program, of all platforms: name, version, licence and folder."""
    tree = ["cargo", "tree", "--package", package, "--edges", "normal,no-proc-macro", "--target", "all"]
    lines = subprocess.run([*tree, "--prefix", "none", "--format", "{p}"], cwd=FOLDER, capture_output=True, check=True)
    used = {tuple(line.split()[:2]) for line in lines.stdout.decode().splitlines() if line}
    metadata = ["cargo", "metadata", "--format-version", "1"]
    known = json.loads(subprocess.run(metadata, cwd=FOLDER, capture_output=True, check=True).stdout)["packages"]
    found = [
        {
            "name": package["name"],
            "version": package["version"],
            "license": package["license"] or "",
            "authors": re.sub(r" *<[^>]*>", "", ", ".join(package["authors"])) or f"the authors of {package['name']}",
            "folder": str(Path(package["manifest_path"]).parent),
        }
        for package in known
        if package["source"] and (package["name"], f"v{package['version']}") in used
    ]
    return sorted(found, key=lambda crate: (crate["name"], crate["version"]))


def is_apache(expression: str) -> bool:
    """Whether the Apache License is one of the choices."""
    return " AND " not in expression and "Apache-2.0" in re.split(r"\s+OR\s+|/", expression)


def texts(crate: dict[str, str]) -> list[str]:
    """The licence texts that a crate needs beside the Apache License: also those of C code in its subfolders."""
    folder = Path(crate["folder"])
    files = sorted(path for path in folder.rglob("*") if path.is_file() and TEXTS.match(path.name))
    if is_apache(crate["license"]):
        files = [path for path in files if path.parent != folder or path.name.upper().startswith("NOTICE")]
    found = [path.read_text(encoding="utf-8", errors="replace").strip() for path in files]
    if not found and not is_apache(crate["license"]):
        if crate["license"] != "MIT":
            raise SystemExit(f"{crate['name']}: the package has no text of {crate['license']}")
        ours = (FOLDER / "LICENSE-MIT").read_text(encoding="utf-8").strip()
        found = [re.sub(r"(?m)^Copyright.*$", f"Copyright (c) {crate['authors']}", ours)]
    return found


def page(package: str) -> str:
    """The text of the file."""
    listed = crates(package)
    name = "The Python module snake_rs" if package == WHEEL else f"The program {package}"
    head = f"{name} contains these Rust crates. Crates with the Apache License 2.0 among their licences are\n"
    head += "used under it; its text is in LICENSE-APACHE. The other texts follow.\n\n"
    head += "\n".join(f"{crate['name']} {crate['version']}: {crate['license']}" for crate in listed)
    by_text: dict[str, list[str]] = {}
    for crate in listed:
        for text in texts(crate):
            by_text.setdefault(text, []).append(f"{crate['name']} {crate['version']}")
    parts = [f"{', '.join(dict.fromkeys(names))}\n\n{text}" for text, names in by_text.items()]
    return f"\n\n{RULE}\n".join([head, *parts]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare the file, and write nothing")
    parser.add_argument("--package", default=WHEEL, help="crate of the program")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    arguments = parser.parse_args()
    text = page(arguments.package)
    if not arguments.check:
        arguments.output.write_text(text, encoding="utf-8")
    elif arguments.output.read_text(encoding="utf-8") != text:
        raise SystemExit(f"{OUTPUT.name} is not that of Cargo.lock: python python/third_party_licenses.py")


if __name__ == "__main__":
    main()
