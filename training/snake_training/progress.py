"""Progress of long work: a bar on a terminal, else a line now and then."""

import sys

from tqdm import tqdm

INTERVAL = 10
"""Seconds between two lines."""


class Lines:
    """The standard error for a bar that is not on a terminal: each of its states is a line."""

    def write(self, text):
        if text := text.strip("\r\n "):
            sys.stderr.write(text + "\n")

    def flush(self):
        sys.stderr.flush()


def bar(items=None, **options):
    """`tqdm` with these options; without a terminal a line at the beginning, every `INTERVAL` seconds and at the end."""
    if sys.stderr.isatty():
        return tqdm(items, **options)
    return tqdm(items, file=Lines(), mininterval=INTERVAL, miniters=1, ascii=True, ncols=100, **options)
