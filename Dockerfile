# docker build -t mapweave .
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" mapweave map robot1.bag robot2.mcap --out result
FROM python:3.13-slim AS wheel
WORKDIR /source
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY src src
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .

FROM python:3.13-slim
WORKDIR /install
COPY constraints.txt .
COPY --from=wheel /wheel .
RUN pip install --no-cache-dir -c constraints.txt ./*.whl
# whoever runs it, so that results belong to the caller: a home, and kernels that the image has compiled already
ENV HOME=/home/robot NUMBA_CACHE_DIR=/kernels
RUN useradd --create-home robot && mkdir /kernels /data \
 && mapweave self-test && mapweave doctor && chmod -R a+rwX /kernels /home/robot /data
USER robot
WORKDIR /data
ENTRYPOINT ["mapweave"]
CMD ["--help"]
