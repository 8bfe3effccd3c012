# docker build -t mapweave . && docker run --rm -v "$PWD:/data" mapweave map robot1.bag robot2.mcap --out result
FROM python:3.13-slim AS wheel
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .

FROM python:3.13-slim
WORKDIR /install
COPY constraints.txt .
COPY --from=wheel /wheel .
RUN pip install --no-cache-dir -c constraints.txt ./*.whl && useradd --create-home robot
USER robot
WORKDIR /data
# kernels compiled once are kept in the image
RUN mapweave doctor
ENTRYPOINT ["mapweave"]
CMD ["--help"]
