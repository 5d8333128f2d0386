"""The service by which a station stores a calibration."""

import dataclasses
import json

from drfmcw_msgs.srv import StoreCalibration

from drfmcw_ros.calibration.document import Document, from_content, parse_document

from .calls import Remote


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a station says."""

    accepted: bool
    reason: str
    version: int  # under which it is stored


class RemoteCalibrations(Remote):
    """Calls the stations."""

    async def store(self, document: Document, operator: str) -> Answer:
        """Ask a document's station to store and use it.

        Raises:
            Unreachable: the station does not answer.
        """
        request = StoreCalibration.Request(document=document.text(), operator_name=operator)
        answer = await self._call(StoreCalibration, f'/{document.station}/store_calibration', request)
        return Answer(answer.accepted, answer.reason, answer.version)


def typed_document(text: str, where: str) -> Document:
    """Return the document that a text in YAML or JSON holds.

    YAML 1.1 takes JSON's 2e-08 for a text, so JSON is read as such.

    Raises:
        ConfigurationError: of no such format, checksum of another content, or implausible.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    return from_content(content, where) if isinstance(content, dict) else parse_document(text, where)
