"""What is timed, as programs that both checkouts can run; each prints one JSON object of numbers.

Only COMMANDS asks for nothing but the command line; the others name modules, by the names of this checkout.
"""

__all__ = ["COMMANDS", "COMPILE", "IMPORTS", "RASTER"]

RASTER = """
import json, statistics, sys, time
import numpy as np
from engine.lab.raster.sh_gradients import sh_colors_backward
from engine.lab.evaluate.bench.raster import bench_camera
from engine.formats import read_model
from engine.raster import Gradients, backward, draw, prepare_view, render
model = read_model(sys.argv[1]).model
camera = bench_camera(model, 1297, 840)
rendering = draw(model, camera)
view, colors = rendering.view, rendering.colors
cotangent = np.random.default_rng(0).normal(size=rendering.image.shape).astype(np.float32)
sh_gradient, gradients = np.empty_like(model.sh), Gradients.empty(model)
def backward_color():
    to_sh = view.backward_colors(cotangent)
    sh_colors_backward(to_sh, model.sh, model.means, camera.position, colors=colors, out=sh_gradient)
stages = {
    "forward": lambda: render(model, camera),
    "prepare": lambda: prepare_view(model, camera),
    "blend": lambda: view.render(colors),
    "colour backward": backward_color,
    "full backward": lambda: backward(rendering, cotangent, out=gradients),
}
result = {}
for name, stage in stages.items():
    stage()
    times = []
    for _ in range(int(sys.argv[2])):
        start = time.perf_counter()
        stage()
        times.append(time.perf_counter() - start)
    result[name] = statistics.median(times)
print(json.dumps(result))
"""

COMPILE = """
import json, time
start = time.perf_counter()
from engine.flows.warmup.kernel_warmup import warm_up
warm_up("everything")
print(json.dumps({"compile everything": time.perf_counter() - start}))
"""

IMPORTS = """
import json, subprocess, sys, time
result = {}
for name, module in {
    "import the command line": "engine.cli.app",
    "import embedding": "engine.flows.embed.embedding",
    "import verification": "engine.flows.verify.search",
}.items():
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import " + module], check=True)
    result[name] = time.perf_counter() - start
print(json.dumps(result))
"""

COMMANDS = """
import json, os, subprocess, sys, tempfile, time
from pathlib import Path
scene = sys.argv[1]
result = {}
def run(name, *arguments):
    start = time.perf_counter()
    command = [sys.executable, "-m", "service.cli", *map(str, arguments), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    said = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{name}: status {status}")
    if name:
        result[name] = time.perf_counter() - start
        result[name + ", processor"] = usage.ru_utime + usage.ru_stime
        result[name + ", peak MB"] = usage.ru_maxrss / 1024
        stages = json.loads(said).get("seconds_by_stage", {})
        result.update({name + ": " + stage: took for stage, took in stages.items()})
with tempfile.TemporaryDirectory() as place:
    folder = Path(place)
    key, record, marked = folder / "owner.key", folder / "a.record", folder / ("marked" + Path(scene).suffix)
    moved, picture = folder / "moved.ply", folder / "picture.png"
    run("", "keygen", key)
    run("embed", "embed", scene, marked, "--key", key, "--record", record, "--profile", "fast")
    run("", "attack", "similarity", marked, moved, "--strength", "4")
    run("", "render", marked, picture)
    run("verify model", "verify", moved, "--key", key, "--record", record)
    run("verify picture", "verify", picture, "--key", key, "--record", record)
print(json.dumps(result))
"""
