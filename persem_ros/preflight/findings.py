"""What a check found, as one sentence, and what to type: the words of preflight."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
import re
from shlex import quote

REFUSE, WARN, NOTE = 'refuse', 'warn', 'note'
FLAG = re.compile(r'--set ([a-z_.]+)=(\S*[\w\])])')     # in a sentence
PLACEHOLDER = re.compile(r'-?[A-Z*]+')       # TOPIC, FILE: to be filled in


@dataclass(frozen=True)
class Remedy:
    """
    Settings that are typed together.

    Attributes
    ----------
    settings : mapping of str to str
        {dotted name: value as it is typed}, in order.
    when : str
        In which case, '' in any: 'if they place the body'.

    """

    settings: Mapping[str, str]
    when: str = ''

    def text(self, live: bool = False) -> str:
        """Return the flags: '--set a=b', for a node '-p a:=b'."""
        flags = ' '.join(flag(name, value, live) for name, value in self.settings.items())
        return f'{flags} {self.when}' if self.when else flags


@dataclass(frozen=True)
class Finding:
    """
    One thing that a look before mapping found.

    Attributes
    ----------
    severity : str
        REFUSE where the map would surely be wrong or empty, WARN where it may be, NOTE where
        something was decided that the user should know.
    sentence : str
        A main clause with the numbers, without a full stop and without flags.
    remedies : tuple of Remedy
        Alternatives; () where there is nothing to type.
    takes : mapping of str to str
        Settings that a replay takes over by itself and that stand in its results' config.yaml.
        A node never does: it names them.

    """

    severity: str
    sentence: str
    remedies: tuple[Remedy, ...] = ()
    takes: Mapping[str, str] = field(default_factory=dict)

    @property
    def proposal(self) -> dict[str, str]:
        """Return the settings of the first remedy, {} where something has to be filled in."""
        settings = dict(self.remedies[0].settings if self.remedies else
                        FLAG.findall(self.sentence)[:1])
        return {} if any(map(PLACEHOLDER.fullmatch, settings.values())) else settings

    def text(self, live: bool = False) -> str:
        """Return the sentence with the flags to type."""
        remedies = self.remedies
        if self.takes and live:
            remedies = (Remedy(self.takes), *remedies)
        flags = ', or '.join(remedy.text(live) for remedy in remedies)
        return f'{self.sentence}: {flags}' if flags else self.sentence


def flag(name: str, value: str, live: bool = False) -> str:
    """Return a setting as it is typed: '--set a=b', for a node '-p a:=b'."""
    return f'-p {quote(f"{name}:={value}")}' if live else f'--set {quote(f"{name}={value}")}'


def of_severity(findings: Iterable[Finding], *severities: str) -> list[Finding]:
    """Return the findings of some severities."""
    return [finding for finding in findings if finding.severity in severities]
