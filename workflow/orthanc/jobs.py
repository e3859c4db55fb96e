"""The queue: one row for each series of a fraction, in a file that survives whatever ends Orthanc."""

import sqlite3
import threading
import time

# waiting  for its planning side, `why` says for what
# ready    to be run
# running  the program is at work
# storing  its results are whole, and go into the archive
# done, refused, failed
# planning is no fraction: a structure set of planning lies on it
# earlier  was in the archive before the node's first start
STATES = ["waiting", "ready", "running", "storing", "done", "refused", "failed", "planning", "earlier"]
COLUMNS = ["series", "patient", "digest", "state", "why", "note", "tries", "came", "ended"]
GROWN = "the series has grown: what was stored of the shorter one, if anything, is out of date"


class Jobs:
    def __init__(self, path):
        """The queue of a file; a new one knows that nothing was there before (`fresh`)."""
        self.lock = threading.RLock()
        self.fresh = not path.exists()
        self.rows = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
        self.rows.execute(
            "CREATE TABLE IF NOT EXISTS jobs (series TEXT PRIMARY KEY, patient TEXT NOT NULL, digest TEXT NOT NULL, "
            "state TEXT NOT NULL, why TEXT NOT NULL DEFAULT '', note TEXT NOT NULL DEFAULT '', "
            "tries INTEGER NOT NULL DEFAULT 0, came REAL NOT NULL, "
            "ended REAL)"
        )

    def ask(self, words, *values):
        with self.lock:
            return self.rows.execute(words, values).fetchall()

    def all(self):
        return self.read("ORDER BY came, rowid")

    def get(self, series):
        return next(iter(self.read("WHERE series = ?", series)), None)

    def read(self, which, *values):
        rows = self.ask(f"SELECT {', '.join(COLUMNS)} FROM jobs {which}", *values)
        return [dict(zip(COLUMNS, row)) for row in rows]

    def came(self, series, patient, digest, state="waiting"):
        """A series is whole. One that is known counts again only if it has grown since."""
        with self.lock:
            known = self.get(series)
            if known is None:
                now = time.time()
                self.ask(
                    "INSERT INTO jobs (series, patient, digest, state, came) VALUES (?, ?, ?, ?, ?)",
                    series,
                    patient,
                    digest,
                    state,
                    now,
                )
            # One at work is looked at when it ends.
            elif known["digest"] != digest and known["state"] not in ("planning", "running", "storing"):
                self.again(series, digest, GROWN)

    def again(self, series, digest, note=""):
        self.ask(
            "UPDATE jobs SET state = 'waiting', digest = ?, why = '', note = ?, tries = 0, ended = NULL WHERE series = ?",
            digest,
            note,
            series,
        )

    def set(self, series, state, why=""):
        ended = time.time() if state in ("done", "refused", "failed") else None
        self.ask("UPDATE jobs SET state = ?, why = ?, ended = ? WHERE series = ?", state, why, ended, series)

    def begin(self, series, digest):
        """Counts one more try, on the instances of a digest; returns how many there were before."""
        with self.lock:
            before = self.get(series)["tries"]
            self.ask(
                "UPDATE jobs SET state = 'running', why = '', digest = ?, tries = tries + 1 WHERE series = ?",
                digest,
                series,
            )
            return before

    def count(self, series, storing):
        """How many tries there were; one that failed as it stored was not begun anew, and counts here."""
        with self.lock:
            if storing:
                self.ask("UPDATE jobs SET tries = tries + 1 WHERE series = ?", series)
            return self.get(series)["tries"]
