"""Names and types of all topics of the contract, in one place."""

STATION_TOPICS = {
    'sweep_config': 'drfmcw_msgs/msg/SweepConfig',
    'calibration': 'drfmcw_msgs/msg/StationCalibration',
    'if_samples': 'drfmcw_msgs/msg/IfSamples',
    'if_samples_compressed': 'drfmcw_msgs/msg/CompressedIfSamples',
    'if_spectrum': 'drfmcw_msgs/msg/IfSpectrum',
    'if_spectrum_excerpt': 'drfmcw_msgs/msg/IfSpectrum',
    'beat_frequency': 'drfmcw_msgs/msg/BeatFrequency',
    'beat_frequency_excerpt': 'drfmcw_msgs/msg/BeatFrequency',
    'status': 'drfmcw_msgs/msg/StationStatus',
    'sweep_request': 'drfmcw_msgs/msg/SweepConfig',
    'sweep_schedule': 'drfmcw_msgs/msg/SweepSchedule',
    'schedule_request': 'drfmcw_msgs/msg/SweepSchedule',
}
"""Last name of a topic in a station's namespace: its type."""

SITE_TOPICS = {
    '/site/temperature': 'sensor_msgs/msg/Temperature',
    '/site/pressure': 'sensor_msgs/msg/FluidPressure',
    '/site/humidity': 'sensor_msgs/msg/RelativeHumidity',
    '/reference/range': 'drfmcw_msgs/msg/ReferenceRange',
}
"""Topics of the site and of the reference instrument."""

PAIR_TOPICS = {
    'range': 'drfmcw_msgs/msg/RangeEstimate',
    'range_batch': 'drfmcw_msgs/msg/RangeBatch',
    'range_sensor': 'sensor_msgs/msg/Range',
}
"""Last name of a topic under /<first>/<second>: its type."""

MEASURED_STATION_TOPICS = ('sweep_config', 'sweep_schedule', 'calibration', 'if_samples', 'status')
"""What a station measures or is set to; everything else is computed from it."""

DISPLAYED = {
    'if_spectrum': 'if_spectrum_excerpt',
    'beat_frequency': 'beat_frequency_excerpt',
    'range': 'range_batch',
}
"""Last name of a stream: that of its companion for displays, which costs the stream's publisher fewer messages."""

_PER_PEER = ('sweep_config', 'sweep_request', 'sweep_schedule', 'schedule_request')
_LATCHED = (*_PER_PEER, 'calibration')


def is_latched(topic: str) -> bool:
    """Return True for topics whose last message reaches late joiners (transient local)."""
    return topic.rsplit('/', 1)[-1] in _LATCHED


def is_per_peer(topic: str) -> bool:
    """Return True for topics with one publisher per peer, so that each keeps the last message of its pair."""
    return topic.rsplit('/', 1)[-1] in _PER_PEER


def is_for_displays(topic: str) -> bool:
    """Return True for topics that repeat in fewer messages what another topic has."""
    return topic.rsplit('/', 1)[-1] in DISPLAYED.values()


def is_measured(topic: str) -> bool:
    """Return True for topics that cannot be computed from others."""
    return topic in SITE_TOPICS or topic.rsplit('/', 1)[-1] in MEASURED_STATION_TOPICS


def split_station_topic(topic: str) -> tuple[str, str]:
    """Return (station, last name) of a topic in a station's namespace, ('', last name) where it is in none."""
    station, _, name = topic.lstrip('/').rpartition('/')
    return station, name
