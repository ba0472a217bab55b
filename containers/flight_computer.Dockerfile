# The flight computer: `alula fly`, `link`, `replay` and `trust`, without the workbench's packages and without a compiler.
#
#     docker build -f containers/flight_computer.Dockerfile -t alula-fly .
#     docker run --rm --network host --device /dev/ttyAMA0 --group-add dialout --cap-add SYS_NICE --ulimit rtprio=80 \
#         -v "$PWD":/home/alula/flights alula-fly fly --link serial:/dev/ttyAMA0:921600 --bundle bundles/my_quad \
#         --reference hover --record recordings
#
# It flies bundles that `alula export` wrote; bundled vehicles by name need a wheel with kernels instead (make wheel).
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
COPY requirements/flight_computer.lock /tmp/flight_computer.lock
RUN python -m pip install --no-cache-dir --require-hashes --no-deps --requirement /tmp/flight_computer.lock
COPY --from=wheel /wheels /tmp/wheels
RUN python -m pip install --no-cache-dir --no-deps /tmp/wheels/*.whl && rm -rf /tmp/wheels
RUN useradd --create-home --uid 1000 --groups dialout alula \
    && mkdir /home/alula/flights && chown alula /home/alula/flights
USER alula
WORKDIR /home/alula/flights
ENTRYPOINT ["alula"]
CMD ["--help"]
