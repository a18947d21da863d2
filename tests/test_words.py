"""The words of the code are those of the field, and not a dialect of its own: `docs/words.md`."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# The number that is reached, for each habit that ends. It only falls.
MAX_COUNTS = {
    r"\blet (mut )?found\b": 1,
    r"\bof_[a-z_]+\b": 0,
    r"\bconst (LEAST|MOST)_": 0,
    r"\bmatch [^{;]*\{\s*(true|false) =>": 0,
    r"\bturned": 2,
}


@pytest.fixture(scope="module")
def sources():
    folders = ROOT / "crates", ROOT / "python" / "src"
    return [path.read_text() for folder in folders for path in sorted(folder.rglob("*.rs"))]


@pytest.mark.parametrize("habit", MAX_COUNTS)
def test_words_of_the_dialect_do_not_come_back(sources, habit):
    assert sum(len(re.findall(habit, text)) for text in sources) <= MAX_COUNTS[habit]


def test_the_page_of_words_is_short_and_names_what_is_counted():
    page = (ROOT / "docs" / "words.md").read_text()
    assert len(page.splitlines()) <= 40
    assert all(word in page for word in ("found", "of_", "LEAST_", "MOST_", "turned", "match condition"))
