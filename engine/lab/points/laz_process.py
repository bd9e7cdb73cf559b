"""Program of its own: LAZ on standard input, the unpacked point records on standard output.

lazrs allocates whatever the sizes in a file say, and a failed allocation ends the process: so it gets a process with a
limit of memory.
"""

import io
import sys


def main() -> None:
    """Unpack under the limit, in bytes, of the first argument."""
    import laspy

    try:
        import resource
    except ImportError:  # Windows has no such limit
        pass
    else:
        resource.setrlimit(resource.RLIMIT_DATA, (int(sys.argv[1]), int(sys.argv[1])))
    data = io.BytesIO(sys.stdin.buffer.read())
    reader = laspy.LasReader(data, read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs)
    sys.stdout.buffer.write(reader.read_points(-1).array.tobytes())


if __name__ == "__main__":
    main()
