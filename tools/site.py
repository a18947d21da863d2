"""Gathers the pages of the site in target/site-pages: the Markdown of the repository where it stands, and three pages made from code.

`make site` runs it and then MkDocs. Links to what is no page lead to the repository.
"""

import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "target/site-pages"
REPOSITORY = "https://github.com/snake-rs/snake-rs/blob/main/"
PICTURES = (".png", ".svg")
STYLE = """.md-typeset table:not([class]) { font-size: .72rem; }
.md-typeset pre > code { font-size: .72rem; }
.md-grid { max-width: 72rem; }
"""
PYTHON = """# Python

`snake_rs` as `help()` shows it. [A first tour](../python/README.md) has examples.

::: snake_rs
    options: {show_root_heading: false, show_root_toc_entry: false, filters: ["!^_"]}

::: snake_rs.baselines

::: snake_rs.steps
"""


def pages() -> list[str]:
    """The pages of the navigation that stand in the repository, and those that only they link."""
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = re.findall(r"([\w./-]+\.md)$", config.split("\nnav:")[1], re.MULTILINE)
    return [name for name in named if (ROOT / name).is_file()]


def copied(page: str, known: list[str]) -> str:
    """The text of a page; its pictures are copied, and its links to other files lead to the repository."""

    def link(found: re.Match) -> str:
        name, mark, anchor = found[2].partition("#")
        if "://" in name or not name:
            return found[0]
        path = ((ROOT / page).parent / name).resolve().relative_to(ROOT.resolve())
        if path.suffix in PICTURES:
            target = PAGES / path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, target)
        elif str(path) not in known:
            return f"{found[1]}({REPOSITORY}{path}{mark}{anchor})"
        return found[0]

    return re.sub(r"(\])\(([^)\s]+)\)", link, (ROOT / page).read_text(encoding="utf-8"))


def rust() -> str:
    """The list of crates, with links to their documentation."""
    rows = []
    for manifest in sorted(ROOT.glob("crates/*/Cargo.toml")):
        description = re.search(r'^description = "(.*)"$', manifest.read_text(encoding="utf-8"), re.MULTILINE)
        name = manifest.parent.name
        module = name.replace("-", "_")
        if (manifest.parent / "src/lib.rs").is_file() and description:
            # Cargo writes these pages beside the site: the address is that of the built site.
            rows.append(f'| <a href="../../rustdoc/{module}/index.html"><code>{name}</code></a> | {description[1]} |')
    table = "\n".join(["| crate | content |", "|---|---|", *rows])
    return f"# Rust\n\n{table}\n\n[Embedding](../docs/embedding.md) has three levels of the interface with examples.\n"


def tutorial() -> str:
    """The tutorial as a page."""
    return f"# Tutorial\n\n```python\n{(ROOT / 'docs/tutorial.py').read_text(encoding='utf-8')}```\n"


def main() -> None:
    shutil.rmtree(PAGES, ignore_errors=True)
    known = pages()
    made = {"api/python.md": PYTHON, "api/rust.md": rust(), "docs/tutorial.md": tutorial(), "site.css": STYLE}
    for name, text in ({page: copied(page, known) for page in known} | made).items():
        (PAGES / name).parent.mkdir(parents=True, exist_ok=True)
        (PAGES / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
