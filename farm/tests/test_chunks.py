"""Chunks by number: farm/chunk.sh, alone and as Kubernetes and Slurm call it."""

import os
import pathlib
import shlex
import shutil
import signal
import socket as socketlib
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from conftest import CHUNK, FARM, FRAMES, digests

CHUNKS = FRAMES // CHUNK


def chunk(index, job, environment, out, **more):
    command = [FARM / "chunk.sh", str(index)]
    return subprocess.Popen(command, cwd=job, env=environment | {"OUT": out}, **more)


def killed_in_the_midst(job, environment, out):
    """Kills chunk 5 between its third and its last frame. A try that the chunk outruns does not count."""
    for _ in range(20):
        process = chunk(5, job, environment, out)
        deadline = time.monotonic() + 60
        while process.poll() is None and len(list((job / out).glob("frame_*.png"))) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        code, there = process.wait(), digests(job / out)
        if code == -signal.SIGKILL and 3 <= len(there) < 3 * CHUNK:
            return there
        assert code in (0, -signal.SIGKILL)
        shutil.rmtree(job / out)
    raise AssertionError("20 chunks ended before they could be killed")


def test_chunks_in_any_order_are_one_run_though_one_is_killed(job, environment):
    there = killed_in_the_midst(job, environment, "killed")
    written = {name: (job / "killed" / name).stat().st_mtime_ns for name in there}
    with ThreadPoolExecutor(2) as pool:
        order = [5, 0, 7, 3, 1, 6, 2, 4]
        assert list(pool.map(lambda k: chunk(k, job, environment, "killed").wait(), order)) == [0] * CHUNKS
    assert digests(job / "killed") == digests(job / "whole")
    # None is made twice.
    assert written == {name: (job / "killed" / name).stat().st_mtime_ns for name in there}


def test_a_chunk_beyond_the_path_is_refused(job, environment):
    process = chunk(CHUNKS, job, environment, "beyond", stderr=subprocess.PIPE)
    said = process.communicate()[1].decode()
    assert process.returncode == 2
    assert said == "chunk 8: expected a chunk below 8, as many as 96 frames have\n"


def test_kubernetes_runs_the_chunk_of_its_index(job, environment):
    yaml = pytest.importorskip("yaml", reason="skipped: no PyYAML")
    spec = yaml.safe_load((FARM / "kubernetes.yaml").read_text())["spec"]
    assert spec["completionMode"] == "Indexed"
    container = spec["template"]["spec"]["containers"][0]
    values = {entry["name"]: entry["value"] for entry in container["env"]}
    # What the file asks for covers its path: 300 frames in chunks of 32.
    frames, length = int(values["FRAMES"]), int(values.get("CHUNK", 32))
    assert spec["completions"] == (frames - 2) // length + 1
    assert set(values) <= {"SCENE", "FRAMES", "CHUNK", "OUT", "OPTIONS", "GS3"}
    codes = spec["podFailurePolicy"]["rules"][0]
    assert codes["action"] == "FailIndex" and codes["onExitCodes"]["values"] == [2]
    command = [word.replace("/opt/gs3/", f"{FARM}/") for word in container["command"]]
    environment |= {"JOB_COMPLETION_INDEX": "3", "OUT": "pod"}
    subprocess.run(command, cwd=job, env=environment, check=True)
    made = digests(job / "pod")
    assert len(made) == 3 * CHUNK and made.items() <= digests(job / "whole").items()


def free_ports(count):
    """Ports of loopback that nothing listens on."""
    sockets = [socketlib.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


@pytest.fixture
def slurm(tmp_path, environment):
    """The environment of a Slurm cluster of this machine alone, its daemons on loopback."""
    for program in ["slurmctld", "slurmd", "munged"]:
        if shutil.which(program) is None:
            pytest.skip(f"skipped: {program} (Debian's slurm-wlm) is not installed")
    if os.geteuid() != 0:
        pytest.skip("skipped: slurmd starts as root only")
    cluster = pathlib.Path(tmp_path)
    for folder in ["state", "spool", "log", "munge"]:
        (cluster / folder).mkdir(mode=0o755)
    host = subprocess.check_output(["hostname", "-s"], text=True).strip()
    key, socket = cluster / "munge" / "munge.key", cluster / "munge" / "socket"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o400)
    controller, daemon = free_ports(2)
    conf = cluster / "slurm.conf"
    conf.write_text(
        f"""ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={daemon}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={socket}
CredType=cred/munge
StateSaveLocation={cluster}/state
SlurmdSpoolDir={cluster}/spool
SlurmctldPidFile={cluster}/slurmctld.pid
SlurmdPidFile={cluster}/slurmd.pid
SlurmctldLogFile={cluster}/log/slurmctld
SlurmdLogFile={cluster}/log/slurmd
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_interval=1,batch_sched_delay=0
NodeName={host} NodeAddr=127.0.0.1 CPUs={os.cpu_count()} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""
    )
    (cluster / "cgroup.conf").write_text("CgroupPlugin=cgroup/v1\nConstrainCores=no\n")
    munge = [f"--key-file={key}", f"--socket={socket}", f"--pid-file={cluster}/munge/pid"]
    munge += [f"--log-file={cluster}/munge/log", f"--seed-file={cluster}/munge/seed", "--force", "--foreground"]
    environment |= {"SLURM_CONF": str(conf)}
    daemons = [["munged", *munge], ["slurmctld", "-D", "-c"], ["slurmd", "-D", "-c"]]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    said = lambda command: subprocess.run(command, env=environment, capture_output=True, text=True).stdout  # noqa: E731
    # Each daemon starts when the one before it answers: slurmctld ends where munge's socket is not there.
    answers = [socket.exists, lambda: "UP" in said(["scontrol", "ping"]), lambda: "idle" in said(["sinfo", "-h", "-o", "%T"])]
    running = []
    try:
        for daemon, answers_now in zip(daemons, answers):
            running.append(subprocess.Popen(daemon, **quiet))
            deadline = time.monotonic() + 120
            while not answers_now():
                if time.monotonic() > deadline or running[-1].poll() is not None:
                    logs = [cluster / "munge" / "log", *(cluster / "log").iterdir()]
                    text = "\n".join(file.read_text()[-2000:] for file in logs if file.is_file())
                    raise AssertionError(f"{daemon[0]} does not answer (exit code {running[-1].returncode}):\n{text}")
                time.sleep(0.2)
        yield environment
    finally:
        for daemon in reversed(running):
            daemon.terminate()
            daemon.wait(30)


def test_slurm_renders_an_array(job, slurm):
    submit = shlex.split(f"sbatch --wait --array=0-{CHUNKS - 1} --cpus-per-task=1 {FARM}/slurm.sbatch")
    done = subprocess.run(submit, cwd=job, env=slurm | {"OUT": "slurm"}, capture_output=True, text=True, timeout=300)
    said = "\n".join(file.read_text() for file in job.glob("slurm-*.out"))
    assert done.returncode == 0, f"{done.stderr}\n{said}"
    assert len(list(job.glob("slurm-*.out"))) == CHUNKS
    assert digests(job / "slurm") == digests(job / "whole")
