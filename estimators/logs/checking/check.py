"""All findings about a log at once: the file, the names, the description, the data, what each command can do.

The check does what a user would: it adds each line that it prints to the YAML in memory, reads the log
again, and goes on. What it prints is therefore exactly what makes the log readable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from estimators.logs.checking.columns import table_remarks
from estimators.logs.checking.conventions import conventions
from estimators.logs.checking.description import description_remarks, stand_in, without_section
from estimators.logs.checking.fitness import fitness, uneven, unjudged
from estimators.logs.checking.from_quality import quality_remarks
from estimators.logs.checking.mends import Line, Remark, last_lines
from estimators.logs.checking.names import file_names, log_columns, name_remarks
from estimators.logs.description_files import find_description, shared_description
from estimators.logs.log import Log
from estimators.logs.quality import QualityReport, quality
from estimators.logs.reading import check_path, read_described
from offroad_env.errors import DataError
from offroad_env.world.files import MOST_TEXT, read_file

__all__ = ["CheckReport", "check_description", "check_log", "with_lines"]

#: Lines that refusals of the reader name.
_NAMED = (
    Line("time.repeated", "merge"),
    Line("time.order", "sort"),
    Line("time.missing", "drop"),
    Line("csv.incomplete", "drop"),
)
#: Why no command takes a log that is read with a stand-in for something.
_UNMENDED = "a problem above has no line that mends it"
#: How a YAML is read that is not UTF-8: Latin-1 with the signs that editors on Windows add to it.
_FALLBACK = "cp1252"
#: Rounds of mounting, signs and units: one may show another.
_ROUNDS = 6


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """What a check found."""

    name: str  #: of the log
    description: Path  #: the YAML to which lines are to be added
    remarks: tuple[Remark, ...]  #: in the order in which they are to be read
    log: Log | None  #: as it is read with the lines added; None where no line mends it
    quality: QualityReport | None  #: of that log
    commands: dict[str, str]  #: command -> "" if it takes the log with these lines, or why it does not
    obstacle: str = ""  #: why no line can be added to the YAML as it is; empty where lines can be

    @property
    def lines(self) -> tuple[Line, ...]:
        """All lines to add, one for each key."""
        return tuple(last_lines(self.remarks).values())

    @property
    def readable(self) -> bool:
        """Whether the log can be read once the lines are added."""
        return self.log is not None


class _Session:
    """The YAML in memory, and what was found so far."""

    def __init__(self, path: Path, description: Path, text: str) -> None:
        self.path, self.description, self._text = path, description, text
        self.remarks: list[Remark] = []
        self.obstacle = ""
        self._stand_ins: list[Line] = []

    @property
    def unmended(self) -> bool:
        """Whether there is a problem that no line mends."""
        return any(remark.severity == "problem" and not remark.lines for remark in self.remarks)

    @property
    def text(self) -> str:
        """The YAML with all lines added, and with values in place of those that no line mends."""
        text = self._text
        for line in self._stand_ins:
            text = without_section(text, line.key)
        kept = [line for line in last_lines(self.remarks).values() if not self._stands_in(line.key)]
        return with_lines(text, [*kept, *self._stand_ins])

    def _stands_in(self, key: str) -> bool:
        return any(key == line.key or key.startswith(f"{line.key}.") for line in self._stand_ins)

    def add(self, remarks: Iterable[Remark]) -> None:
        """Keep findings."""
        self.remarks += remarks

    def fail(self, sentence: str) -> None:
        """Keep a problem that no line mends."""
        self.remarks.append(Remark(severity="problem", sentence=sentence))

    def go_on(self, obstacle: str, how: str) -> None:
        """Keep why the YAML cannot be read as it is, and how the check goes on all the same."""
        self.obstacle = obstacle
        self.fail(f"{obstacle} - {how}, so that the rest can be checked")

    def put_in(self, lines: Iterable[Line]) -> None:
        """Values that only this check uses, to go on."""
        self._stand_ins += lines

    def read(self) -> Log:
        """The log as it is with the lines."""
        return read_described(self.path, self.text.encode(), str(self.description))


def with_lines(text: str, lines: Iterable[Line]) -> str:
    """The YAML with lines at its end, as a user adds them."""
    end = "" if not text or text.endswith("\n") else "\n"
    return text + end + "".join(f"{line}\n" for line in lines)


def check_log(path: Path) -> CheckReport:
    """Check one log.

    Raises
    ------
    DataError
        If there is no such file, or it is none that a log can be read from.
    """
    check_path(path)
    session = _session(path)
    usable = _try(session, lambda: name_remarks(path, session.text))
    session.add(description_remarks(session.text, str(session.description), session.put_in))
    usable = usable and _try(session, lambda: table_remarks(path, session.text, str(session.description)))
    # Of the file and its description; in spite of what the numbers show later a command may go on.
    unmended = session.unmended
    log = _read(session) if usable else None
    report = None
    if log is not None:
        log, report = _data(session, log)
    if log is not None:
        session.add(unjudged(log))
    commands = {} if log is None else fitness(log)
    if unmended:
        commands = {command: reason or _UNMENDED for command, reason in commands.items()}
    return CheckReport(
        name=path.stem,
        description=session.description,
        remarks=tuple(session.remarks),
        log=log,
        quality=report,
        commands=commands,
        obstacle=session.obstacle,
    )


def check_description(path: Path) -> CheckReport:
    """Check a YAML without its data.

    Raises
    ------
    DataError
        If it cannot be read.
    """
    session = _described(path, path)
    session.add(description_remarks(session.text, str(path), lambda lines: None))
    return CheckReport(
        name=path.stem,
        description=path,
        remarks=tuple(session.remarks),
        log=None,
        quality=None,
        commands={},
        obstacle=session.obstacle,
    )


def _session(path: Path) -> _Session:
    try:
        description = find_description(path)
    except DataError as error:
        session = _Session(path, shared_description(path), stand_in())
        session.go_on(str(error), "here the vehicle is a stand-in")
        return session
    return _described(path, description)


def _described(path: Path, description: Path) -> _Session:
    """With the text of the YAML; the reader refuses what is not UTF-8, and so does this, but goes on."""
    content = read_file(description, most=MOST_TEXT)
    try:
        return _Session(path, description, content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        session = _Session(path, description, content.decode(_FALLBACK, "replace"))
        line = error.object.count(b"\n", 0, error.start) + 1
        session.go_on(
            f"{description}: is not UTF-8 text (line {line}): save it as UTF-8",
            "here it is read as Windows-1252",
        )
        return session


def _try(session: _Session, work: Callable[[], list[Remark]]) -> bool:
    """Findings of a stage; False where it cannot go on."""
    try:
        session.add(work())
    except DataError as error:
        session.fail(str(error))
        return False
    return True


def _read(session: _Session) -> Log | None:
    """The log with the lines so far; a refusal that names a line is a finding with that line."""
    for _ in range(len(_NAMED) + 1):
        try:
            return session.read()
        except DataError as error:
            line = next((line for line in _NAMED if str(line) in str(error)), None)
            if line is None:
                session.fail(str(error))
                return None
            session.add([Remark(severity="problem", sentence=str(error), lines=(line,))])
    return None


def _data(session: _Session, log: Log) -> tuple[Log | None, QualityReport | None]:
    """Mounting, signs and units round by round, then everything that is left."""
    current: Log | None = log
    names = file_names(session.path, session.text)
    seen: set[tuple[str, ...]] = set()
    report = quality(log)
    for _ in range(0 if log.rig else _ROUNDS):
        if current is None:
            return None, None
        report = quality(current)
        files = frozenset(log_columns(session.path, names, session.text))
        remarks = conventions(current, files) or quality_remarks(current, report, files)
        mended = [remark for remark in remarks if remark.lines]
        key = tuple(str(line) for remark in mended for line in remark.lines)
        if not mended or key in seen:
            break
        seen.add(key)
        session.add(mended)
        current = _read(session)
    if current is None:
        return None, None
    mended_sentences = {remark.sentence for remark in session.remarks}
    session.add(
        Remark(severity=finding.severity, sentence=finding.sentence)
        for finding in report.findings
        if finding.sentence not in mended_sentences
    )
    return _even(session, current, report)


def _even(session: _Session, log: Log, report: QualityReport) -> tuple[Log | None, QualityReport | None]:
    """An even rate of the IMU, where a filter needs one."""
    found = uneven(log)
    if found is None:
        return log, report
    session.add([found])
    again = _read(session)
    return (log, report) if again is None else (again, replace(quality(again), findings=report.findings))
