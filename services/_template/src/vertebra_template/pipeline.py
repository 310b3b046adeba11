"""What the template does with a message; pure, so that it can be tested without a bus."""

from __future__ import annotations

from vertebra.messages import Text


def greet(name: Text, greeting: str) -> Text:
    """Return the greeting for one name."""
    return Text(text=f"{greeting}, {name.text.strip()}!", language=name.language)
