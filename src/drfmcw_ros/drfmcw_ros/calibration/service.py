"""The service by which a host stores a calibration on a station: the station's side and the host's."""

import os
import time
from collections.abc import Callable

import rclpy
from drfmcw_msgs.srv import StoreCalibration
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from drfmcw_physics.rules.plausible import printable_line
from drfmcw_physics.settings import ConfigurationError

from ..nodes.runner import RCLError
from ..operation.security import refuse_pretence
from .document import Document, parse_document
from .store import CalibrationStore

_LONGEST = 1 << 16  # of a document [letters]
_LONGEST_OPERATOR = 100


def store_on_station(station: str, document: str, operator: str, limit: float) -> int:
    """Store a document on a running station; return the version that it has there.

    Args:
        station: name of the station.
        document: YAML.
        operator: who stores it.
        limit: for the answer [s].

    Raises:
        ConfigurationError: the station refuses the document, or does not answer within `limit`.
    """
    refuse_pretence(os.environ)
    context = Context()
    try:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = Node('calibration_client', context=context)
        try:
            return _call(node, station, StoreCalibration.Request(document=document, operator_name=operator), limit)
        finally:
            node.destroy_node()
    except NameValidationException:
        raise ConfigurationError(f"'{printable_line(station)}' is no name of a station") from None
    except RCLError as error:  # ROS_DOMAIN_ID
        raise ConfigurationError(str(error).partition(', at /')[0]) from None
    finally:
        context.try_shutdown()


def _call(node: Node, station: str, request: StoreCalibration.Request, limit: float) -> int:
    end = time.monotonic() + limit
    name = f'/{station}/store_calibration'
    client = node.create_client(StoreCalibration, name)
    if not client.wait_for_service(limit):
        raise ConfigurationError(
            f"nobody offers {name} within {limit:g} s: is station '{station}' running, with a source "
            'of its own (tcp, udp), in this ROS domain?'
        )
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        answer = client.call_async(request)
        executor.spin_until_future_complete(answer, max(0.0, end - time.monotonic()))
    finally:
        executor.shutdown()
    response = answer.result() if answer.done() else None
    if response is None:
        raise ConfigurationError(
            f"'{station}' does not answer within {limit:g} s; whether it has stored the document is not known"
        )
    if not response.accepted:
        raise ConfigurationError(f"'{station}' refuses the {printable_line(response.reason)}")
    return int(response.version)


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
