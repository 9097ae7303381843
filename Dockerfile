# docker build -t fretflow . && docker run --rm -v "$PWD:/work" fretflow run examples/quick.toml
#
# Not yet built by docker; its steps were carried out in a bare Debian 13.
FROM debian:13-slim
COPY . /opt/fretflow
# The launcher sets up what is missing and cleans nothing of apt's; what it fetched is not kept in the image.
RUN /opt/fretflow/fretflow --version \
    && apt-get clean && rm -rf /var/lib/apt/lists/* /root/.cache/pip
WORKDIR /work
ENTRYPOINT ["/opt/fretflow/fretflow"]
