# Cloak in a container, for the CPU or for CUDA:
#
#   docker build -t cloak .
#   docker run --rm -v "$PWD:/work" cloak demo --out demo
#   docker run --rm --gpus all -v "$PWD:/work" cloak train --logo chest+thighs --out run
#
# Torch from the package index brings CUDA, 6 GB, and runs on the CPU as well. A smaller image without CUDA:
#   docker build --build-arg TORCH_INDEX=ADDRESS -t cloak .     # ADDRESS of torch's wheels for the CPU, see its install page
FROM python:3.11-slim-bookworm

ARG TORCH_INDEX=
# More of what docs/install.md lists: --build-arg EXTRAS=onnx,film,ultralytics (the last is AGPL-3.0).
ARG EXTRAS=onnx,film

# What numba's compiled loops and OpenCV are linked against; the image's Debian says in which version.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libglib2.0-0 \
    && rm -rf /var/lib/apt/lists/*

# Torch first: it is most of the image, and stays in the cache of layers when the code changes.
# hadolint ignore=DL3013
RUN pip install --no-cache-dir ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} torch torchvision

COPY . /src
RUN pip install --no-cache-dir "/src[$EXTRAS]" && rm -rf /src

# Nobody's rights beyond what a run needs; compiled loops and fitted people are kept in the cache folder.
RUN useradd --create-home --uid 1000 cloak && mkdir /work && chown cloak /work
USER 1000
ENV CLOAK_CACHE=/home/cloak/.cache/cloak NUMBA_CACHE_DIR=/home/cloak/.cache/numba
# Compile the loops now, so that the first command does not.
RUN python -m cloak_core train --scene "sample:train[0]" --logo chest --steps 1 --batch 1 --size 64 --translation 4 \
    --preview-every 0 --device cpu --out /tmp/run && rm -rf /tmp/run

WORKDIR /work
ENTRYPOINT ["cloak"]
CMD ["--help"]
