FROM python:3.11-slim-bookworm AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE NOTICE ./
COPY core core
COPY services services
COPY workers workers
COPY migrations migrations
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.11-slim-bookworm
COPY --from=build /wheels /wheels
COPY requirements/constraints.txt /wheels/constraints.txt
RUN pip install --no-cache-dir --constraint /wheels/constraints.txt /wheels/*.whl && rm -r /wheels \
    && useradd --create-home --uid 10001 wayloom && mkdir /data && chown wayloom /data
USER wayloom
ENV PYTHONUNBUFFERED=1
VOLUME /data
EXPOSE 8088
CMD ["python", "-m", "wayloom_services"]
