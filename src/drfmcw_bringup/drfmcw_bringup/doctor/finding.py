"""One line of the doctor."""

import dataclasses

OK, WARN, ERROR = 'OK', 'WARN', 'ERROR'


@dataclasses.dataclass(frozen=True)
class Finding:
    """What was found out about one subject."""

    level: str
    subject: str
    said: str
    advice: str = ''  # what to do, for WARN and ERROR

    def line(self) -> str:
        """Return the finding as one line."""
        return f'{self.level:<5}  {self.subject:<14} {self.said}' + (f' -> {self.advice}' if self.advice else '')
