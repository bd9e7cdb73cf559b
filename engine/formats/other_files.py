"""Files that are mistaken for a Gaussian model: what they are, and what to give or export instead."""

import codecs
import re
from collections.abc import Callable
from dataclasses import dataclass

RAW_PHOTO = "is a camera's raw file: save the developed picture as PNG or JPEG"
RAW_ENDINGS = (".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef", ".srw", ".dng")

ZIP_WITHOUT_SCENE = "is a zip archive without a model in it (.ply, .sog, .spz and so on, or a meta.json): give a model"

_HEAD, _TAIL = 4096, 1 << 16
_FEW_ENDS = 32
_HEIC, _AVI, _MATROSKA = (b"heic", b"heix", b"heim", b"heis", b"mif1", b"msf1"), b"AVI ", b"\x1aE\xdf\xa3"
_PICTURES = (b"\0\0\0\x0cjP  ", b"\0\0\0\x0cJXL ", b"II+\0", b"MM\0+", b"\xabKTX 20\xbb", b"#?RGBE")
_MESH_TEXT = re.compile(rb"(?:\A|\n)(?:mtllib \S|usemtl \S|v +[-+.\d])|<COLLADA")
_NO_TEXT = re.compile(r"[^\t\n\r -~\xa0-\U0010ffff]")
_BLANKS = b"\xef\xbb\xbf \t\r\n"
_CONVERTED = "splat-transform converts it (npx @playcanvas/splat-transform FILE model.ply)"
_NO_MODEL = "no Gaussian model: give the splat that was made from the same photos, as .ply, .sog or .spz"


@dataclass(frozen=True)
class _Other:
    """One kind of file, recognized by its first bytes, else by its content, else by the end of its name."""

    text: str
    starts: tuple[bytes, ...] = ()
    holds: Callable[[bytes], bool] = lambda _: False
    endings: tuple[str, ...] = ()


def _boxed(*brands: bytes) -> Callable[[bytes], bool]:
    """Whether this is a file of the MPEG-4 family, of these brands or of any."""
    return lambda data: data[4:8] == b"ftyp" and (not brands or data[8:12] in brands)


def _zip_with(*names: bytes) -> Callable[[bytes], bool]:
    """Whether this is a zip archive whose first entry, or whose list of entries, has a name that ends so."""
    return lambda data: data.startswith(b"PK") and any(n in data[:_HEAD] or n in data[-_TAIL:] for n in names)


def _json_with(*members: bytes) -> Callable[[bytes], bool]:
    """Whether this is the text of a JSON object or list with one of these members."""
    return lambda data: data[:_HEAD].lstrip(_BLANKS)[:1] in (b"{", b"[") and any(b'"%s"' % m in data for m in members)


_KINDS = (
    _Other(
        "is a PyTorch checkpoint, which is never opened here (it can run code): export its Gaussians as .ply (gsplat: "
        "gsplat.export_splats, or train with --save_ply; nerfstudio: ns-export gaussian-splat --load-config config.yml "
        "--output-dir DIR; INRIA: point_cloud/iteration_N/point_cloud.ply in its folder)",
        holds=_zip_with(b"/data.pkl"),
        endings=(".pt", ".pth", ".ckpt", ".pkl"),
    ),
    _Other(
        "is a numpy file: its arrays have no agreed names; write them as .ply (gsplat.export_splats)",
        (b"\x93NUMPY",),
        _zip_with(b".npy"),
        (".npz", ".npy"),
    ),
    _Other(
        "holds the weights of a network or the tensors of a training: export its Gaussians as .ply",
        (b"\x89HDF",),
        lambda data: data[4:9] == b"\0\0\0\0{",  # safetensors: the length of a JSON header, and that
        (".safetensors", ".h5", ".hdf5", ".onnx", ".ingp", ".msgpack"),
    ),
    _Other(
        "is a scene of XGRIDS (LCC), one file of several: export .ply from LCC Studio, or " + _CONVERTED,
        holds=_json_with(b"totalSplats", b"totalLevel", b"splatType"),
        endings=(".lcc", ".lcc2"),
    ),
    _Other(
        "is a streamed scene of Spark (.rad): give the .ply, .spz or .sog that it was built from; where your version "
        "of splat-transform reads it, " + _CONVERTED,
        (b"RAD0",),
        endings=(".rad",),
    ),
    _Other(
        "is a scene that moves (.splatv), or one for another viewer (.spx, which gsbox converts: gsbox spx2ply): give"
        " the .ply that it was made from",
        (b"KG\0\0", b"spx"),
        endings=(".splatv", ".spx"),
    ),
    _Other(
        "is a project or a checkpoint of Postshot or LichtFeld Studio: export the scene as .ply (File > Export)",
        endings=(".psht", ".licht", ".resume"),
    ),
    _Other(
        "is a list of 3D Tiles, or a tile of a version before 1.1: give one of the .glb files with Gaussians that a"
        " tileset.json names",
        (b"b3dm", b"i3dm", b"pnts", b"cmpt"),
        holds=_json_with(b"geometricError"),
    ),
    _Other(
        "is the index of a SOG scene: give its folder, or the .sog", holds=_json_with(b"lodLevels", b"codebook", b"shN")
    ),
    _Other(
        "holds cameras, no Gaussians: give the model, and this with --cameras",
        holds=_json_with(b"frames", b"rotation", b"camera_model"),
    ),
    _Other(
        "is the configuration of a nerfstudio training: export the model (ns-export gaussian-splat --load-config FILE "
        "--output-dir DIR)",
        holds=lambda data: b"!!python/object:nerfstudio" in data[:_HEAD],
    ),
    _Other(
        "begins like a PLY, but its first line is not 'ply' alone: a text editor or a redirected output changed it;"
        " export it again",
        (b"PLY", "ply".encode("utf-16"), "\ufeffply".encode("utf-16-be")),
        lambda data: data[:64].lstrip(_BLANKS).startswith((b"ply\n", b"ply\r", b"ply ")),
    ),
    _Other("is a pointer of git-lfs, not the file itself: fetch it (git lfs pull)", (b"version https://git-lfs",)),
    _Other(
        f"is a point cloud, {_NO_MODEL}; verify also accepts colored ones as .ply",
        (b"LASF", b"ASTM-E57", b"# .PCD", b"VERSION .7"),
        endings=(".las", ".laz", ".e57", ".pcd", ".xyz", ".pts", ".ptx", "points3d.bin", "points3d.txt"),
    ),
    _Other(
        f"is a mesh, {_NO_MODEL}; verify also takes pictures of it, and a mesh with colors at its corners (.ply, .obj,"
        " .glb) or with its texture inside (.glb)",
        (b"Kaydara FBX Binary", b"; FBX", b"BLENDER", b"solid "),
        lambda data: b"\0" not in data[:_HEAD] and _MESH_TEXT.search(data[:_HEAD]) is not None,
        (".obj", ".fbx", ".stl", ".dae", ".blend", ".3ds", ".off"),
    ),
    _Other(
        "is a picture, not a model: only verify accepts pictures",
        (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"II*\0", b"MM\0*"),
        lambda data: data[8:12] == b"WEBP" or (_boxed()(data) and b"avif" in data[8:32]),
    ),
    _Other("is a HEIC photo: save it as JPEG or PNG", holds=_boxed(*_HEIC)),
    _Other(
        "is a picture of a kind that is not read (JPEG 2000, JPEG XL, JPEG XR, PSD, SVG, EXR, HDR, TGA, KTX and the"
        " like): save it as PNG or JPEG, as it is displayed",
        (*_PICTURES, b"\xff\x4f\xff\x51", b"\xff\x0a", b"8BPS", b"<svg", b"v/1\1", b"#?RADIANCE", b"II\xbc\1", b"DDS "),
        lambda data: re.match(rb"P[1-7]\s+[\d#]|qoif", data) is not None,
        (".jp2", ".jxl", ".jxr", ".psd", ".svg", ".exr", ".hdr", ".tga", ".ico"),
    ),
    _Other(RAW_PHOTO, (b"FUJIFILMCCD-RAW",), _boxed(b"crx "), RAW_ENDINGS),
    _Other(
        "is a video: save some of its frames, unscaled (ffmpeg -i VIDEO -vf fps=1 FRAMES/%04d.png), and give those",
        (_MATROSKA,),
        lambda data: _boxed()(data) or data[8:12] == _AVI,
    ),
    _Other("is a PDF: save the picture in it as PNG or JPEG", (b"%PDF",)),
    _Other(
        "is a web page: give the model that it loads, or a screenshot of what it shows",
        holds=lambda data: data[:1024].lstrip(_BLANKS).lower().startswith((b"<!doctype html", b"<html")),
    ),
    _Other(ZIP_WITHOUT_SCENE, holds=lambda data: data.startswith(b"PK")),
    _Other(
        "is a packed archive: unpack it, and give one model of those in it",
        (b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"),
        lambda data: data[257:262] == b"ustar",
    ),
    _Other("is a companion file of macOS ('._NAME'): give the file NAME itself", (b"\0\5\x16\7",)),
    _Other(
        "is an asset of Unity or Unreal: give the .ply that it was imported from",
        (b"%YAML 1.1\n%TAG !u!", b"\xc1\x83\x2a\x9e"),
        endings=(".asset", ".uasset", ".unitypackage", ".bytes"),
    ),
    _Other("holds nothing but zeros: copy or download it again", holds=lambda data: not data.strip(b"\0")),
)


def advice_for(data: bytes, file: str) -> str | None:
    """What a file that is none of the formats read here is, and what to do, where its content or its name shows it."""
    signs = (
        lambda other: data.startswith(other.starts),
        lambda other: other.holds(data),
        lambda other: bool(other.endings) and file.lower().endswith(other.endings),
    )
    known = next((other.text for fits in signs for other in _KINDS if fits(other)), None)
    text = _text_of(data[:_HEAD])
    if known is None and text:
        return f"is text, no model: give the file of the model itself; this one begins with {text[:60]!a}"
    return known


def _text_of(head: bytes) -> str:
    """The first bytes as text of any language, which may end within a character; empty where they are none."""
    wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = codecs.getincrementaldecoder("utf-16" if wide else "utf-8-sig")().decode(head)
    except UnicodeDecodeError:
        return ""
    return "" if _NO_TEXT.search(text) else text


def changed_as_text(data: bytes) -> str | None:
    """What was done to a binary file by a program that took it for text, where that shows."""
    ends = data.count(b"\n")
    crlf = ends > _FEW_ENDS and data.count(b"\r\n") == ends and b"\0" in data
    if not crlf and data.count("\ufffd".encode()) * _FEW_ENDS <= len(data):
        return None
    what = "line ends" if crlf else "characters"
    return f"its {what} were changed on the way, as if it were text: transfer or download it again, as binary"
