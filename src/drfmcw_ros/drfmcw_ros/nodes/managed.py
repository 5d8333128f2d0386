"""Nodes with a life cycle (design.ros2.org/articles/node_lifecycle.html) that start by themselves unless asked not to.

unconfigured: parameters and diagnostics only; inactive: topics too, nothing is evaluated or published; active: works.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from drfmcw_physics.settings import ConfigurationError, parameter

from .parameters import SettingsParameters

_DONE, _REFUSED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


@dataclasses.dataclass(frozen=True)
class LifecycleSettings:
    """How a node starts."""

    autostart: bool = parameter(
        True, structural=True, description='configure and activate at start; false: wait for `ros2 lifecycle set`'
    )


class ManagedNode(LifecycleNode):
    """A node whose topics exist from `configure` to `cleanup`, and which works from `activate` to `deactivate`.

    A subclass declares parameters in its constructor, ends it with `begin` and fills in the four methods below that.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        """Create the node, unconfigured; arguments as for rclpy's Node."""
        super().__init__(name, **kwargs)
        self.active = False
        """True while the node evaluates and publishes."""
        self._autostart = SettingsParameters(self, LifecycleSettings).value.autostart
        self._before: set[Any] = set()  # publishers, subscriptions and timers that no transition made
        self._wrong: Exception | None = None  # why the last transition was refused
        answer: Any = self._service_change_state.callback

        def change_state(request: Any, response: Any) -> Any:
            try:
                return answer(request, response)
            except rclpy_implementation.RCLError as error:  # rclpy would leave a wrong request without an answer
                self.get_logger().error(f'no such transition now: {" ".join(str(error).split())}')
                response.success = False
                return response

        self._service_change_state.callback = change_state

    def begin(self) -> None:
        """Configure and activate unless the parameter `autostart` is false.

        Raises:
            ConfigurationError: a setting cannot be used.
        """
        if self._autostart:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != _DONE:
                    raise self._wrong or ConfigurationError(f'{self.get_name()}: cannot start')

    def state(self) -> str:
        """Return what keeps the node from working, 'inactive' or 'unconfigured'; '' while it works."""
        return '' if self.active else str(self._state_machine.current_state[1])

    def configure(self) -> None:
        """Create topics; raises ConfigurationError where a setting cannot be used."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to work; raises ConfigurationError where a setting cannot be used."""

    def deactivate(self) -> None:
        """End what `activate` began."""

    def cleanup(self) -> None:
        """Forget what came in; the topics are gone already."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create topics (rclpy calls this)."""
        self._before = self._entities()
        return self._tried(self.configure, undo=self._destroy)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work (rclpy calls this)."""
        self.active = True  # what `activate` announces is to be published
        return self._tried(self.activate, undo=self._rest)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End working (rclpy calls this)."""
        self._rest()
        return _DONE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy the topics (rclpy calls this)."""
        self._destroy()
        self.cleanup()
        return _DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good, from any state (rclpy calls this)."""
        self._rest()
        self._destroy()
        return _DONE

    def _tried(self, work: Callable[[], None], undo: Callable[[], None]) -> TransitionCallbackReturn:
        """Do what a transition asks for, or say why not and leave the state as it was."""
        try:
            work()
        except Exception as error:  # rclpy would end in error processing, without saying why
            self._wrong = error
            if not self._autostart:
                self.get_logger().error(str(error))
            undo()
            return _REFUSED
        return _DONE

    def _rest(self) -> None:
        was_active, self.active = self.active, False
        if was_active:
            self.deactivate()

    def _entities(self) -> set[Any]:
        return {*self.publishers, *self.subscriptions, *self.timers}

    def _destroy(self) -> None:
        for made in self._entities() - self._before if self._before else ():
            for destroy in (self.destroy_publisher, self.destroy_subscription, self.destroy_timer):
                if destroy(made):
                    break
