# docker build -t bayesdrill .
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" bayesdrill posterior configs/mine.yaml

FROM python:3.13-slim AS build
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir --constraint requirements.lock build hatchling
RUN python -m build --no-isolation --wheel --outdir /wheel

FROM python:3.13-slim
COPY --from=build /source/requirements.lock /wheel/
COPY --from=build /wheel /wheel
RUN pip install --no-cache-dir --constraint /wheel/requirements.lock /wheel/*.whl
RUN useradd --create-home bayesdrill && install --directory --owner bayesdrill /data
# Whatever user is given, figures need a folder for fonts.
ENV MPLCONFIGDIR=/tmp/matplotlib
USER bayesdrill
WORKDIR /data
ENTRYPOINT ["bayesdrill"]
CMD ["--help"]
