"""What results are on Zenoh: CDR, or what ``output.encoding`` makes of it."""

from functools import cache

from fuselog.fusion import Output, Stream
from fuselog.schemas import Transcoder, definition, make_transcoder, schema_to_text
from fuselog.schemas.transcode import Encoding


@cache
def transcoder_of(encoding: Encoding, schema_name: str) -> Transcoder:
    """From CDR of a type that comes with fuselog; one for all filters, of which there may be thousands."""
    return make_transcoder(encoding, schema_name, definition(schema_name))


def stream_of(output: Output, transcoder: Transcoder) -> Stream:
    """What is announced of an output."""
    return Stream(
        topic=output.topic,
        encoding=transcoder.encoding,
        schema_name=transcoder.schema_name,
        schema_encoding=transcoder.schema_encoding,
        schema_text=schema_to_text(transcoder.schema_encoding, transcoder.schema),
    )
