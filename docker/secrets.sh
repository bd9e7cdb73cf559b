#!/bin/sh
# Makes the secrets of compose.scale.yaml, in the folder `secrets` beside it or in the one given; a second run changes
# nothing. Keep a copy of the folder apart: without the master key every owner key in the database is lost.
set -eu
folder=${1:-$(dirname "$0")/secrets}
mkdir -p -m 700 "$folder"
cd "$folder"

random() { od -An -N32 -tx1 /dev/urandom | tr -d ' \n'; }
# Containers read the files under other user ids; on this machine the folder keeps others out.
secret() { [ -e "$1" ] || { printf %s "$2" > "$1.new" && chmod 644 "$1.new" && mv "$1.new" "$1"; }; }

secret master_key "$(random)"
secret postgres_password "$(random)"
secret database_url "postgresql://mark3dgs:$(cat postgres_password)@postgres:5432/mark3dgs"
secret store_user mark3dgs
secret store_password "$(random)"
