#!/bin/sh
set -eu
if [ ! -s "$PGDATA/PG_VERSION" ]; then
  chown postgres:postgres "$PGDATA"
  setpriv --reuid=postgres --regid=postgres --init-groups \
    initdb --encoding=UTF8 --locale=C.UTF-8 --username="$POSTGRES_USER" \
    --pwfile="$POSTGRES_PASSWORD_FILE" --auth-host=scram-sha-256 --auth-local=trust
  echo "host all all all scram-sha-256" >> "$PGDATA/pg_hba.conf"
  echo "CREATE DATABASE $POSTGRES_DB" |
    setpriv --reuid=postgres --regid=postgres --init-groups postgres --single -j -E -D "$PGDATA" postgres
fi
exec setpriv --reuid=postgres --regid=postgres --init-groups \
  postgres -c listen_addresses='*' -c unix_socket_directories=/tmp
