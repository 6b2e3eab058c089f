"""Where the files are."""

from pathlib import Path

MONITORING = Path(__file__).parents[2] / "docs" / "monitoring"
ALERTS = MONITORING / "vcu-gateway-alerts.yaml"
DASHBOARD = MONITORING / "vcu-gateway-dashboard.json"
README = MONITORING / "README.md"
