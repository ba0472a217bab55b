# The workbench: logs in, diagnoses, trained models and bundles out.
#
#     docker build -f containers/workbench.Dockerfile -t alula-workbench .
#     docker run --rm -v "$PWD":/home/alula/work alula-workbench diagnose logs --vehicle my_quad.toml --html report.html
#
# Every version comes with the hashes of requirements/, torch aside: --build-arg TORCH_INDEX=URL takes another build of it
# than the package index has, such as the much smaller one for processors alone (docs/supply_chain.md).
FROM python:3.11-slim-bookworm AS wheel
WORKDIR /source
COPY requirements/build.lock requirements/build.lock
RUN python -m pip install --no-cache-dir --require-hashes --no-deps --requirement requirements/build.lock
COPY pyproject.toml setup.py README.md LICENSE ./
COPY alula alula
COPY diagnosis diagnosis
COPY dynamics dynamics
COPY export export
COPY flights flights
COPY runtime runtime
COPY simulation simulation
COPY sitl_mock sitl_mock
COPY studies studies
COPY studio studio
COPY training training
COPY vehicles vehicles
RUN python -m pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /wheels .

FROM python:3.11-slim-bookworm
# the compiler makes the kernels of the models that are diagnosed and exported; Chromium saves pictures (--figures)
RUN apt-get update \
    && apt-get install --yes --no-install-recommends gcc libc6-dev chromium \
    && rm -rf /var/lib/apt/lists/*
ARG TORCH_INDEX=
COPY constraints.txt requirements/workbench.lock /tmp/
RUN python -m pip install --no-cache-dir --require-hashes --no-deps --requirement /tmp/workbench.lock \
    && python -m pip install --no-cache-dir --constraint /tmp/constraints.txt ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} \
        torch==2.13.0
COPY --from=wheel /wheels /tmp/wheels
RUN python -m pip install --no-cache-dir --no-deps /tmp/wheels/*.whl && rm -rf /tmp/wheels
RUN useradd --create-home --uid 1000 alula && mkdir /home/alula/work && chown alula /home/alula/work
USER alula
WORKDIR /home/alula/work
ENTRYPOINT ["alula"]
CMD ["--help"]
