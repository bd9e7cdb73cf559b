# Stands in for postgres:17-bookworm where it cannot be pulled: Debian's server with the same variables and folders.
FROM python:3.11-slim-bookworm
RUN apt-get update -q && apt-get install -q -y --no-install-recommends postgresql postgresql-client \
 && rm -rf /var/lib/apt/lists/* /var/lib/postgresql/15 && ln -s /usr/lib/postgresql/15/bin/* /usr/local/bin/
COPY postgres-entrypoint.sh /usr/local/bin/
ENV PGDATA=/var/lib/postgresql/data PGHOST=/tmp
RUN install -d -o postgres -g postgres -m 0700 "$PGDATA"
VOLUME /var/lib/postgresql/data
STOPSIGNAL SIGINT
ENTRYPOINT ["postgres-entrypoint.sh"]
