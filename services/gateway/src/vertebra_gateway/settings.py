"""Settings of the gateway."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from pydantic import Field, SecretStr
from pydantic_settings import SettingsConfigDict

from vertebra.errors import ConfigError
from vertebra.service import ServiceSettings
from vertebra_gateway.profile import load_profiles

_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{16,}")
_REMEDY: Final = 'python3 -c "import secrets; print(secrets.token_urlsafe(24))"'


class GatewaySettings(ServiceSettings):
    """The robots of the fleet on the web: REST, WebSocket, MJPEG and a dashboard."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_GATEWAY_")

    host: str = Field("127.0.0.1", description="Address to listen on; loopback unless told so.")
    tcp_port: int = Field(8080, ge=0, le=65535, description="TCP port to listen on; 0 takes any.")
    token: SecretStr = Field(SecretStr(""), description="What everybody has to show.")
    token_file: Path | None = Field(None, description="File that holds the token instead.")
    allowed_origins: tuple[str, ...] = Field(
        (), description="Origins of other web pages that may use the gateway."
    )
    robots: Path = Field(Path("deploy/robots"), description="Folder of the robot profiles.")
    jpeg_quality: int = Field(80, ge=1, le=95, description="Quality of the JPEG images it makes.")

    def check(self) -> None:
        """See `ServiceSettings.check`."""
        self.read_token()
        load_profiles(self.robots)

    def read_token(self) -> str:
        """Return the token in force.

        Raises:
            ConfigError: There is none, or it is too short to be safe in a cookie or header.
        """
        token = self.token.get_secret_value()
        where = "VERTEBRA_GATEWAY_TOKEN"
        if self.token_file is not None:
            if token:
                raise ConfigError(
                    "set VERTEBRA_GATEWAY_TOKEN or VERTEBRA_GATEWAY_TOKEN_FILE, not both"
                )
            where = str(self.token_file)
            try:
                token = self.token_file.read_text(encoding="utf-8").strip()
            except OSError as error:
                raise ConfigError(f"the token cannot be read: {error}") from error
        if not token:
            raise ConfigError(
                "the gateway needs a token: set VERTEBRA_GATEWAY_TOKEN_FILE to a file that holds "
                f"one; make one with: {_REMEDY}"
            )
        if _TOKEN.fullmatch(token) is None:
            raise ConfigError(
                f"the token in {where} has {len(token)} characters; it needs at least 16 of "
                f"A-Z a-z 0-9 _ - and no others; make one with: {_REMEDY}"
            )
        return token
