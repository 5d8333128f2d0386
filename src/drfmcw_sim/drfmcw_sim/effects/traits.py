"""What an effect declares about itself, so that nobody else has to know its name."""

import enum


class Of(enum.StrEnum):
    """What one instance of an effect belongs to."""

    STATION = 'station'
    PATH = 'path'
    REFERENCE = 'reference'


class ActsOn(enum.Flag):
    """Quantities of the signal model that an effect changes."""

    CLOCK = enum.auto()
    PHASE = enum.auto()
    DELAY = enum.auto()
    AMPLITUDE = enum.auto()
    NOISE = enum.auto()
    SAMPLES = enum.auto()
    REFERENCE = enum.auto()

    @property
    def words(self) -> str:
        """The quantities, separated by commas."""
        return ', '.join(str(quantity.name).lower() for quantity in self)


class Stage(enum.IntEnum):
    """Order in which effects act: that in which the signal passes them, not that of a scenario's list."""

    STATE = 0  # clocks, air, motion, powers, and what is added to the IF
    GEOMETRY = 1  # effect of the antennas' heights on distance and motion
    PATHS = 2  # more paths and losses, which follow the final distance
    FILTER = 3
    AMPLIFIER = 4
    LIMITER = 5


class Motion(enum.Enum):
    """How an effect moves the crane."""

    NONE = enum.auto()
    DRIVE = enum.auto()  # evenly, which the slope of the reference's readings shows
    SWAY = enum.auto()  # to and fro within the sweeps at one distance, which the reference does not show


class Stated(enum.StrEnum):
    """Numbers that a calibration, the weather or the reference state, of which an effect may be the error; in words."""

    DELAY = 'hardware delay'
    DELAY_SLOPE = 'temperature slope of the delay'
    CLOCK = 'reference clock'
    CLOCK_SLOPE = 'temperature slope of the reference clock'
    SAMPLE_CLOCK = 'ADC clock beside the reference'
    AIR = 'refractivity of the air'
    REFERENCE_ZERO = 'zero of the reference instrument'
    REFERENCE_SCALE = 'scale of the reference instrument'
