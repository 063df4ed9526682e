"""Submits a job to a tilecast coordinator and watches it, through the same protocol as the program's own clients.

    pip install grpcio grpcio-tools
    python -m grpc_tools.protoc -I proto/proto --python_out=. --grpc_python_out=. render.proto
    python submit.py HOST:PORT JOB [--spp N] [--certs DIR]

The scene is one that the coordinator has: JOB is the number of a job (as `tilecast status` shows it) whose scene and settings are taken, with
another number of samples. Parsing scene files is what `tilecast submit` is for; what a scene's blobs are is in core/src/scene/blobs.rs.
"""

import argparse
import pathlib

import grpc

import render_pb2
import render_pb2_grpc


def channel(address, certs):
    if certs is None:
        return grpc.insecure_channel(address)
    read = lambda name: (pathlib.Path(certs) / name).read_bytes()
    credentials = grpc.ssl_channel_credentials(read("ca.pem"), read("client.key"), read("client.pem"))
    # Every coordinator has this name in its certificate, whatever its address is.
    return grpc.secure_channel(address, credentials, [("grpc.ssl_target_name_override", "coordinator.tilecast")])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("job", type=int)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--certs")
    flags = parser.parse_args()
    jobs = render_pb2_grpc.JobsStub(channel(flags.address, flags.certs))

    known = {progress.job: progress for progress in jobs.ListJobs(render_pb2.ListJobsRequest())}
    if flags.job not in known:
        raise SystemExit(f"the coordinator knows no job {flags.job}; it has {sorted(known)}")
    pattern = known[flags.job]

    settings = render_pb2.Settings()
    settings.CopyFrom(pattern.settings)
    settings.spp = flags.spp
    job = jobs.SubmitJob(render_pb2.Job(
        scene=pattern.scene, settings=settings, name=f"{pattern.name} from Python",
        sample_starts=[0], sample_ends=[flags.spp],
    ))
    print(f"job {job.job}: {flags.spp} samples a pixel")

    for progress in jobs.WatchJob(job):
        done = progress.samples_done / progress.samples_total
        error = progress.relative_error.value if progress.HasField("relative_error") else float("nan")
        print(f"{done:6.1%}  {progress.workers} workers  relative error {error:.2%}")
    state = render_pb2.JobState.Name(progress.state)
    print(f"{state} after {progress.elapsed_ms / 1000:.1f} s {progress.message}".rstrip())
    if progress.state != render_pb2.JOB_STATE_FINISHED:
        raise SystemExit(1)

    for one in jobs.ListContributions(job):
        print(f"{one.worker.host}: {one.worker.units_done} units, {one.worker.samples_done} samples")
    film_bytes = sum(len(chunk.sums) for chunk in jobs.FetchFilm(job))
    print(f"the film's sums have {film_bytes} bytes")


if __name__ == "__main__":
    main()
