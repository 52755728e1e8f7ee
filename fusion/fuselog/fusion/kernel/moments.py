"""The moments at which samples count; compiled with ``step``.

A moment is one stamp, or one cycle of stamps (``period_ns``), which then counts at its end.
"""

from fuselog.fusion.kernel.layout import LAST, MARKED, MARKS, SENSOR_MARKS
from fuselog.fusion.kernel.tables import History, Tables
from fuselog.schemas.compiled import inline


@inline
def moment(tables: Tables, t: int) -> int:
    """The moment (ns) at which a sample of stamp t (ns) counts: the end of its cycle."""
    return t if tables.period_ns == 0 else -(-t // tables.period_ns) * tables.period_ns


@inline
def last_fused(history: History, k: int, sensor: int) -> int:
    """The moment (ns) of the sensor's last fused sample as entry k knows it, or NEVER."""
    return int(history.marks[k * MARKED + MARKS + sensor * SENSOR_MARKS + LAST])
