"""What a healthy recorder tells of itself."""

from vcu_gateway.recording.recorder_status import RecordedConnection, RecorderStatus, RecorderTotals

STATUS = RecorderStatus(
    pid=123,
    version="0.1.0",
    started_wall_ns=1_763_920_000_000_000_000,
    written_wall_ns=1_763_923_600_000_000_000,
    written_monotonic_ns=5_000_000_000,
    folder="/var/lib/vcu-gateway-recorder",
    total_bytes=32_000_000_000,
    free_bytes=16_000_000_000,
    max_bytes=4 << 30,
    keep_free_bytes=1 << 30,
    incident_max_bytes=1 << 30,
    drives_bytes=100_000_000,
    incidents_bytes=2_000_000,
    incidents=2,
    disk="ok",
    last_error=None,
    waiting_bytes=4096,
    memory_bytes=32 << 20,
    last_sync_s=0.003,
    longest_sync_s=0.02,
    totals=RecorderTotals(bytes=50_000_000, frames=5_000_000, ticks=250_000, syncs=2500),
    refused={},
    bytes_a_second=4000.0,
    connections=(RecordedConnection("can0", "1f3a9c2e", "20251123T174640Z-1f3a9c2e"),),
)
