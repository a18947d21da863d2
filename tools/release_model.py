"""Takes a model that a recipe made into the repository: `python tools/release_model.py NAME`, or `make release-model NAME=compact`.

Copies runs/NAME/NAME.safetensors to where it is released, a large file in parts, writes its digest into the recipe, and renews the golden file that
depends on its weights. The tables and pictures need folders that are not here: at the end the commands that renew them are printed.
"""

import argparse
import json
import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILT_IN = "compact", "scenes"
PART = 4_900_000  # bytes: a larger file lies here in parts
# The file that a built-in model's weights decide.
DEFAULT_PATH = ["cargo", "test", "--release", "--bin", "snake-cli", "--test", "cli", "default_path"]
LEFT = """Left to do, with folders of your own:
  make results OBJECTS=FOLDER LANDMARKS=FOLDER SCENES=FOLDER    # docs/results.md
  the commands of docs/gallery.md, and a look at the pictures
  the card in models/README.md and the rows of README.md"""


def metadata_of(path):
    """The metadata of a safetensors file."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        return json.loads(file.read(length))["__metadata__"]


def release(made, released):
    """Copies a file; one above PART to files with numbered endings, which `make` joins."""
    content = made.read_bytes()
    for old in released.parent.glob(f"{released.name}*"):
        old.unlink()
    parts = [content[first : first + PART] for first in range(0, len(content), PART)]
    for number, part in enumerate(parts):
        path = released if len(parts) == 1 else released.with_name(f"{released.name}.{number}")
        path.write_bytes(part)


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="of a recipe in training/recipes: compact, scenes or paper")
    parser.add_argument("--runs", default="runs", help="folder of the recipes' runs; default: runs")
    arguments = parser.parse_args()
    made = Path(arguments.runs) / arguments.name / f"{arguments.name}.safetensors"
    recipe = ROOT / f"training/recipes/{arguments.name}.toml"
    for path, what in ((recipe, "no such recipe"), (made, f"not made yet: python -m snake_training.recipes {recipe}")):
        if not path.exists():
            parser.error(f"{path}: {what}")
    folder = "crates/snake-core/models" if arguments.name in BUILT_IN else "models"
    released = ROOT / folder / made.name
    release(made, released)
    digest = metadata_of(made)["digest"]
    text = re.sub(r"(?m)^digest = .*\n", "", recipe.read_text())
    output = f'output = "{made.name}"\n'
    recipe.write_text(text.replace(output, f'{output}digest = "{digest}"\n', 1))
    print(f"{released}: {digest}")
    if arguments.name in BUILT_IN:
        subprocess.run(DEFAULT_PATH, check=True, cwd=ROOT, env=os.environ | {"SNAKE_WRITE_GOLDEN": "1"})
    print(LEFT)


if __name__ == "__main__":
    main()
