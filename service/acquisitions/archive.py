"""An acquisition as a WARC file (ISO 28500, version 1.1): every record a gzip member of its own.

warcinfo | for each redirect and the answer: request, response, metadata (address, certificates)
warcinfo | of an uploaded file: resource
"""

import base64
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from warcio.statusandheaders import StatusAndHeaders
from warcio.utils import Digester
from warcio.warcwriter import WARCWriter

from service.acquisitions.fetching import TOOL, Exchange

MEDIA_TYPE = "application/warc"
_CHUNKED = "transfer-encoding"


class _Writer(WARCWriter):  # type: ignore[misc]
    def _create_digester(self) -> Digester:
        return Digester("sha256")


class _Head(StatusAndHeaders):  # type: ignore[misc]
    """Headers as they came: the library would spell them in ASCII."""

    def compute_headers_buffer(self, header_filter: Any = None) -> None:
        self.headers_buff = self.to_bytes(header_filter, "latin-1")


def write_warc(target: Path, body: Path, exchanges: Sequence[Exchange], name: str, at: str) -> None:
    """Write what was fetched, or, without exchanges, what was uploaded at a time under a name.

    `body` is the file of the last answer's body, or the uploaded one.
    """
    with target.open("wb") as file, body.open("rb") as payload:
        writer = _Writer(file, gzip=True, warc_version="1.1")
        writer.write_record(writer.create_warcinfo_record(None, {"software": TOOL, "format": "WARC/1.1"}))
        if not exchanges:
            address = f"file:///{quote(name or 'suspect')}"
            _write(writer, address, "resource", at, payload, {"Content-Type": "application/octet-stream"})
        for number, each in enumerate(exchanges, start=1):
            _write_exchange(writer, each, payload if number == len(exchanges) else io.BytesIO())


def _write_exchange(writer: _Writer, exchange: Exchange, body: Any) -> None:
    request = _Head(f"GET {exchange.target} HTTP/1.1", list(exchange.request_headers), is_http_request=True)
    # The body is kept without its framing in chunks, so the header that announces that goes by another name.
    headers = [(f"X-Archive-Orig-{k}" if k.lower() == _CHUNKED else k, v) for k, v in exchange.answered]
    answered = _Head(exchange.status, headers, protocol="HTTP/1.1")
    there = {"WARC-IP-Address": exchange.address}
    response = _write(writer, exchange.url, "response", exchange.at, body, there, answered)
    links = {"WARC-Concurrent-To": response}
    _write(writer, exchange.url, "request", exchange.at, io.BytesIO(), links | there, request)
    certificates = [base64.b64encode(each).decode() for each in exchange.certificates]
    metadata = json.dumps({"tool": TOOL, "address": exchange.address, "tls_certificates": certificates}).encode()
    links["Content-Type"] = "application/json"
    _write(writer, exchange.url, "metadata", exchange.at, io.BytesIO(metadata), links)


def _write(
    writer: _Writer, url: str, kind: str, at: str, payload: Any, headers: dict[str, str], http: _Head | None = None
) -> str:
    """Id of the record."""
    dated = {"WARC-Date": at.replace("+00:00", "Z"), **headers}
    record = writer.create_warc_record(url, kind, payload, warc_headers_dict=dated, http_headers=http)
    writer.write_record(record)
    return str(record.rec_headers.get_header("WARC-Record-ID"))
