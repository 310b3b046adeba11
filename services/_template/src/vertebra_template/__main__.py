"""Run the template."""

import sys

from vertebra.service import main
from vertebra_template.adapter import serve
from vertebra_template.settings import TemplateSettings

sys.exit(main("template", TemplateSettings, serve))
