"""Makes target/snake.html, one file without a server: python3 build.py (needs `rustup target add wasm32-unknown-unknown`)."""

import base64
import json
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent

metadata = subprocess.run(
    ["cargo", "metadata", "--format-version=1", "--no-deps"], cwd=HERE, capture_output=True, check=True
)
target = Path(json.loads(metadata.stdout)["target_directory"])
subprocess.run(["cargo", "build", "--release"], cwd=HERE, check=True)
module = (target / "wasm32-unknown-unknown" / "release" / "wasm_page.wasm").read_bytes()
page = (HERE / "page.html").read_text().replace("@WASM@", base64.b64encode(module).decode())
(target / "snake.html").write_text(page)
print(target / "snake.html", f"{len(page) / 1e6:.1f} MB")
