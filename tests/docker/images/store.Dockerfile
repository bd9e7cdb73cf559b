# An S3 server of the test's own: it speaks the protocol over HTTP and keeps the objects in memory.
FROM python:3.11-slim-bookworm
RUN python3 -m venv /opt/store && /opt/store/bin/pip install --quiet --no-cache-dir 'moto[server]>=5'
ENTRYPOINT ["/opt/store/bin/moto_server", "--host", "0.0.0.0", "--port", "9000"]
