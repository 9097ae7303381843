# docker build -t fretflow . && docker run --rm -v "$PWD:/work" fretflow run examples/quick.toml
FROM debian:13-slim
COPY . /opt/fretflow
# The launcher sets up what is missing and cleans nothing of apt's; what it fetched is not kept in the image.
RUN /opt/fretflow/fretflow --version \
    && apt-get clean && rm -rf /var/lib/apt/lists/* /root/.cache/pip
WORKDIR /work
ENTRYPOINT ["/opt/fretflow/fretflow"]
