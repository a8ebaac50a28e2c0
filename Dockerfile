# The demo on a CPU. Never built here: no Docker daemon was at hand.
#
#   docker build -t mobilestereonet .
#   docker run --rm --user "$(id -u)" -v "$PWD/demo:/out" mobilestereonet
#
# Another package index: --build-arg PIP_INDEX_URL=... PyTorch's index for CPUs, which makes the image
# some gigabytes smaller: --build-arg PIP_EXTRA_INDEX_URL=...
FROM python:3.11-slim

ARG PIP_INDEX_URL
ARG PIP_EXTRA_INDEX_URL

WORKDIR /app
COPY pyproject.toml README.md LICENSE ./
COPY src src
# hadolint ignore=DL3013
RUN pip install --no-cache-dir "torch==2.13.0" ".[demo]" \
    && install --directory --mode=777 /out

ENV HOME=/tmp
USER 65534
WORKDIR /out
CMD ["msnet", "demo", "-o", "/out"]
