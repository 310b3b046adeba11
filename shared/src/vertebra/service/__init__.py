"""The frame of every service: settings, run loop, logs, metrics, presence, streams, actions."""

from vertebra.service.actions import Feedback, serve_action
from vertebra.service.run import Context, main, run_service, service_key
from vertebra.service.settings import ServiceSettings, describe, load_settings
from vertebra.service.streams import MessagePublisher, MessageReader, Received

__all__ = [
    "Context",
    "Feedback",
    "MessagePublisher",
    "MessageReader",
    "Received",
    "ServiceSettings",
    "describe",
    "load_settings",
    "main",
    "run_service",
    "serve_action",
    "service_key",
]
