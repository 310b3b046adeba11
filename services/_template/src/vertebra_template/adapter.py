"""Wiring: names come in on one key, greetings go out on another."""

from __future__ import annotations

from vertebra.bus import Delivery
from vertebra.messages import Text
from vertebra.service import Context, MessageReader
from vertebra_template.pipeline import greet
from vertebra_template.settings import TemplateSettings


async def serve(context: Context[TemplateSettings]) -> None:
    """Greet until cancelled."""
    settings = context.settings
    publisher = context.publisher(settings.greetings_key)
    greeted = context.counter("template_greeted", "Names that were greeted")
    context.routes[settings.names_key] = settings.greetings_key
    async with context.bus.subscribe(settings.names_key, Delivery.queue(16)) as subscription:
        reader = MessageReader(subscription, context.codecs, Text)
        context.gauge("template_refused", "Names that could not be read", lambda: reader.refused)
        context.ready()
        async for received in reader:
            greeting = greet(received.message, settings.greeting)
            publisher.publish(greeting, captured_ns=received.header.captured_ns)
            greeted.inc()
