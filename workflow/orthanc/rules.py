"""The rules of the node: read from TOML, and checked as a whole before anything is done."""

import shutil
import tomllib
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from pathlib import Path

BROWSERS = ["chromium", "chromium-browser", "google-chrome"]
CHOICES = {
    "dose": ["required", "if-there", "none"],
    "planning": ["only", "newest"],
    "at_refusal": ["attach", "pdf"],
}


@dataclass(frozen=True)
class Rule:
    patients: list
    labels: str
    dose: str = "required"
    planning: str = "only"
    at_refusal: str = "attach"
    settings: str = ""
    threads: int = 0
    keep: bool = False
    fraction_has: dict = field(default_factory=dict)
    structures_have: dict = field(default_factory=dict)

    def bones(self, patient, structures):
        """What `--bones` gets; refuses Patient IDs that would lead out of the folder of the labels."""
        if self.labels in ("structures", "auto"):
            return structures if self.labels == "structures" else "auto"
        if "{patient}" in self.labels and (patient in ("", ".", "..") or set(patient) & set("/\\\0")):
            raise ValueError(f"the Patient ID {patient!r} cannot be the name of a file of labels")
        return self.labels.replace("{patient}", patient)


@dataclass(frozen=True)
class Rules:
    work: Path
    rules: list
    program: str = "aventail"
    browser: str = ""
    tries: int = 5

    def of(self, patient):
        """The first rule that fits a Patient ID, or None."""
        return next((rule for rule in self.rules if any(fnmatchcase(patient, p) for p in rule.patients)), None)


def fits(wanted, tags):
    """Whether tags by keyword have what the patterns want."""
    return all(fnmatchcase(str(tags.get(keyword) or ""), pattern) for keyword, pattern in wanted.items())


def read(path):
    """Rules of a TOML file; ValueError names what is wrong with it."""
    try:
        told = tomllib.loads(Path(path).read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    rules = [rule_of(f"{path}: rule {n + 1}", table) for n, table in enumerate(told.pop("rule", []))]
    check(path, told, Rules, {"rules"})
    if not rules:
        raise ValueError(f"{path}: there is no [[rule]], and nothing would ever be done")
    told["work"] = Path(told["work"])
    if not told["work"].is_absolute():
        raise ValueError(f"{path}: work: {told['work']} must be a whole path")
    told.setdefault("browser", next(filter(None, map(shutil.which, BROWSERS)), ""))
    return Rules(rules=rules, **told)


def rule_of(where, table):
    check(where, table, Rule)
    for name, choices in CHOICES.items():
        if table.get(name, choices[0]) not in choices:
            raise ValueError(f"{where}: {name}: {table[name]!r} is none of {', '.join(choices)}")
    if not all(isinstance(pattern, str) for pattern in table["patients"]):
        raise ValueError(f"{where}: patients: patterns are texts")
    for name in ("fraction_has", "structures_have"):
        if not all(isinstance(pattern, str) for pattern in table.get(name, {}).values()):
            raise ValueError(f"{where}: {name}: patterns are texts")
    if table["labels"] not in ("structures", "auto") and not Path(table["labels"]).is_absolute():
        raise ValueError(
            f"{where}: labels: {table['labels']!r} is neither structures, auto, nor the whole path of a file"
        )
    return Rule(**table)


def check(where, table, kind, apart=frozenset()):
    """Every key is known, of the right type, and those without a default are there."""
    known = {f.name: f for f in fields(kind) if f.name not in apart}
    if unknown := [name for name in table if name not in known]:
        raise ValueError(f"{where}: unknown: {', '.join(unknown)}; known are {', '.join(known)}")
    for name, entry in known.items():
        if name not in table:
            if entry.default is entry.default_factory:
                raise ValueError(f"{where}: {name} is missing")
            continue
        wanted = str if entry.type is Path else entry.type
        if type(table[name]) is not wanted:
            raise ValueError(f"{where}: {name}: {table[name]!r} is not of type {wanted.__name__}")
