"""The service by which a host stores a calibration on a station."""

from collections.abc import Callable

from drfmcw_msgs.srv import StoreCalibration
from rclpy.node import Node

from drfmcw_physics.plausible import printable_line
from drfmcw_physics.settings import ConfigurationError

from .document import Document, parse_document
from .store import CalibrationStore

_LONGEST = 1 << 16  # of a document [letters]
_LONGEST_OPERATOR = 100


class CalibrationService:
    """Stores documents that are plausible and of the own station, and refuses others with the reason."""

    def __init__(
        self, node: Node, name: str, station: str, store: CalibrationStore, use: Callable[[Document], None]
    ) -> None:
        """Offer the service.

        Args:
            node: that offers it.
            name: of the service.
            station: whose calibrations are stored.
            store: where.
            use: called with each document as stored.
        """
        self._node, self._station, self._store, self._use = node, station, store, use
        node.create_service(StoreCalibration, name, self._take)

    def _take(
        self, request: StoreCalibration.Request, response: StoreCalibration.Response
    ) -> StoreCalibration.Response:
        try:
            stored = self._stored(request.document, printable_line(request.operator_name, _LONGEST_OPERATOR))
            response.accepted, response.version = True, stored.version
            response.reason = f'stored as version {stored.version}'
        except ConfigurationError as error:
            response.accepted, response.reason = False, ' '.join(str(error).split())
        self._node.get_logger().info(f'calibration: {printable_line(response.reason)}')
        return response

    def _stored(self, text: str, operator: str) -> Document:
        if len(text) > _LONGEST:
            raise ConfigurationError(f'document: {len(text)} letters; {_LONGEST} are plausible')
        document = parse_document(text, 'document')
        if document.station != self._station:
            raise ConfigurationError(f"document: is of station '{document.station}', this is '{self._station}'")
        stored = self._store.add(document, operator)
        self._use(stored)
        return stored
