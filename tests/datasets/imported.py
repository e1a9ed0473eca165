"""What tests look at in an imported recording."""

from datasets.importers.recording import Recording
from messages.sensors import GnssFix, LidarScan


def scans_of(source: Recording) -> list[LidarScan]:
    """Lidar scans in the order of their receipt."""
    return [message for _, _, message in source.read() if isinstance(message, LidarScan)]


def fixes_of(source: Recording) -> list[GnssFix]:
    """GNSS fixes in the order of their receipt."""
    return [message for _, _, message in source.read() if isinstance(message, GnssFix)]


def reasons(source: Recording) -> dict[str, int]:
    """Numbers of skipped messages by reason."""
    return {reason: count for row in source.table() for reason, count in row.reasons.items()}


def reason_text(source: Recording) -> str:
    """Reasons for which messages were skipped."""
    return " | ".join(reason for row in source.table() for reason in row.reasons)
