#!/bin/sh
# What `mark3dgs` needs in a container, then `mark3dgs` itself.
set -eu

# Secrets that come as files.
for name in MARK3DGS_MASTER_KEY MARK3DGS_DATABASE_URL AWS_ACCESS_KEY_ID AWS_SECRET_ACCESS_KEY; do
  eval "file=\${${name}_FILE:-}"
  if [ -n "$file" ]; then
    value=$(cat "$file")
    export "$name=$value"
  fi
done

# Another user (docker run --user) may not write in the volume: a command that needs no more than its arguments then
# gets a folder of its own, which goes with the container. The service refuses such a volume by itself.
scratch=$MARK3DGS_DATA_DIR
[ -w "$scratch" ] || scratch=$(mktemp -d)

# The image holds the compiled kernels, but numba takes only a cache that it can write to (another processor than the
# builder's needs its own): a copy in the volume, once an image.
kernels=$scratch/numba
NUMBA_CACHE_DIR=$kernels/$(cat /opt/mark3dgs/numba.id)
export NUMBA_CACHE_DIR
if [ ! -d "$NUMBA_CACHE_DIR" ]; then
  mkdir -p "$kernels"
  fresh=$(mktemp -d "$kernels/XXXXXX")
  cp -R --preserve=timestamps /opt/mark3dgs/numba/. "$fresh"
  mv -T "$fresh" "$NUMBA_CACHE_DIR" 2>/dev/null || rm -rf "$fresh"  # another container was first
fi

# Large forms and files in the making go to the volume, not to memory.
export TMPDIR="$scratch/scratch"
mkdir -p "$TMPDIR"

exec mark3dgs "$@"
