"""A journal of finished tasks on disk: each is there before anything else happens to it.

An SQLite database with a write-ahead log: what was recorded outlives the end of the process at any
instant, and a full disk. One process at a time writes to it.
"""

import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tiltcal.core.errors import TiltcalError

DAMAGED = ("not a database", "malformed", "no such column", "encrypted", "corrupt", "datatype")
FAST = 1  # level of compression
TABLES = """
CREATE TABLE IF NOT EXISTS finished (key TEXT PRIMARY KEY, record BLOB NOT NULL) WITHOUT ROWID;
"""


class Journal:
    """Finished tasks by key, each with a record: a text.

    ``open_journal`` makes one.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
        with self._explained():
            connection.execute("PRAGMA locking_mode=EXCLUSIVE")
            connection.execute("PRAGMA journal_mode=WAL")
            connection.execute("PRAGMA synchronous=NORMAL")
            connection.executescript(TABLES)
            self._done = {key for (key,) in connection.execute("SELECT key FROM finished")}

    def __contains__(self, key: str) -> bool:
        return key in self._done

    def __len__(self) -> int:
        return len(self._done)

    def record(self, key: str, record: str) -> None:
        """Write a finished task; one of the same key is replaced.

        Raises:
            TiltcalError: there is no free space for it.
        """
        packed = zlib.compress(record.encode(), FAST)
        with self._explained():
            self._connection.execute("INSERT OR REPLACE INTO finished VALUES (?, ?)", (key, packed))
        self._done.add(key)

    def forget(self, key: str) -> None:
        """Take a task out, so that it is made again."""
        with self._explained():
            self._connection.execute("DELETE FROM finished WHERE key = ?", (key,))
        self._done.discard(key)

    def record_of(self, key: str) -> str | None:
        """The record of a finished task; None of another."""
        with self._explained():
            found = self._connection.execute("SELECT record FROM finished WHERE key = ?", (key,))
            row = found.fetchone()
            return None if row is None else zlib.decompress(row[0]).decode()

    def take_over(self, other: "Journal") -> None:
        """Copy all finished tasks of another journal that this one does not have."""
        with other._explained():
            rows = other._connection.execute("SELECT key, record FROM finished").fetchall()
        with self._explained():
            self._connection.execute("BEGIN")
            self._connection.executemany("INSERT OR IGNORE INTO finished VALUES (?, ?)", rows)
            self._connection.execute("COMMIT")
        self._done.update(key for key, _ in rows)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """One clear error for what SQLite refuses."""
        try:
            yield
        except (sqlite3.Error, zlib.error, UnicodeDecodeError, TypeError) as error:
            text = str(error)
            need, do = "free space for it", "free some space and run the same command again"
            if "locked" in text:
                need, do = "one that no other process writes to", "wait for that process, or end it"
            elif not isinstance(error, sqlite3.Error) or any(w in text for w in DAMAGED):
                need, do = "a journal", "choose another output, or remove it and start again"
            raise TiltcalError(f"journal {self.path}", found=text, need=need, do=do) from error


@contextmanager
def open_journal(path: Path) -> Iterator[Journal]:
    """A journal to read and write, made if there is none.

    Raises:
        TiltcalError: it cannot be made, is no journal, or another process writes to it.
    """
    try:
        connection = sqlite3.connect(path, timeout=1.0, isolation_level=None)
    except sqlite3.Error as error:
        raise TiltcalError(
            f"journal {path}",
            found=str(error),
            need="a folder that can be written",
            do="choose another location",
        ) from error
    try:
        yield Journal(path, connection)
    finally:
        connection.close()
