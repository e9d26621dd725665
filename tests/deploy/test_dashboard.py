"""The dashboard and its sources: every metric that they name is one that a host tells."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path
from typing import Any

import yaml
from prometheus_client.parser import text_string_to_metric_families

from layout import ROOT
from nmes import Client
from processes import process, ready
from servers import PASSWORD, PATIENCE

COMPOSE = ROOT / "deploy" / "compose"
FUNCTIONS = {"sum", "min", "max", "rate", "histogram_quantile", "topk", "bottomk", "label_values"}
WORDS = {"by", "le", "instance", "type", "outcome", "world"}


def dashboard() -> Any:
    return json.loads((COMPOSE / "grafana" / "nmes.json").read_text())


def queries(document: Any) -> list[str]:
    panels = [target["expr"] for panel in document["panels"] for target in panel["targets"]]
    return panels + [each["query"]["query"] for each in document["templating"]["list"]]


def names(query: str) -> set[str]:
    """Returns the metrics that a query in PromQL names."""
    bare = re.sub(r"\{[^}]*\}|\[[^\]]*\]|\"[^\"]*\"", " ", query)
    return set(re.findall(r"[a-zA-Z_:][a-zA-Z0-9_:]*", bare)) - FUNCTIONS - WORDS


def labels(query: str) -> set[str]:
    """Returns the labels by which a query selects or groups."""
    selected = re.findall(r"(\w+)\s*(?:=~|!=|!~|=)", query)
    grouped = [word for group in re.findall(r"by \(([^)]*)\)", query) for word in group.split(",")]
    return {word.strip() for word in (*selected, *grouped)}


def told(folder: Path) -> dict[str, set[str]]:
    """Returns the metrics of a live host in which something happens, with their labels."""
    options = ["--backend", "ballistic", "--mode", "lockstep", "--record", str(folder), "--metrics-port", "0"]
    with process("serve", "--json", "--port", "0", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with Client(port=info["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.step(2)
            with urllib.request.urlopen(f"http://127.0.0.1:{info['metrics_port']}/metrics", timeout=PATIENCE) as page:
                families = list(text_string_to_metric_families(page.read().decode()))
    found: dict[str, set[str]] = {}
    for family in families:
        for sample in family.samples:
            found.setdefault(sample.name, {"instance"}).update(sample.labels)
    return found


def test_every_query_names_metrics_and_labels_that_a_host_tells(tmp_path: Path) -> None:
    live = told(tmp_path)
    document = dashboard()
    used: set[str] = set()
    for query in queries(document):
        assert names(query), query
        for name in names(query):
            assert name in live, f"{query}: no host tells {name}"
            assert labels(query) <= live[name], query
        used |= names(query)
    legends = [target["legendFormat"] for panel in document["panels"] for target in panel["targets"]]
    named = {word for legend in legends for word in re.findall(r"\{\{(\w+)\}\}", legend)}
    assert named <= set().union(*live.values())
    assert {name for name in live if name.startswith("nmes_worlds")} - used == {"nmes_worlds_listed"}


def test_a_metric_that_is_misspelt_would_be_found() -> None:
    assert names('sum by (le) (rate(nmes_tick_secnds_bucket{instance=~"$instance"}[5m]))') == {
        "nmes_tick_secnds_bucket"
    }
    assert names('nmes_worlds{a="nmes_b"} - nmes_clients') == {"nmes_worlds", "nmes_clients"}
    assert labels('sum by (type, le) (rate(x{instance=~"$i", outcome!="ok"}[5m]))') == {
        "type",
        "le",
        "instance",
        "outcome",
    }


def test_panels_have_places_and_sources_of_their_own() -> None:
    document = dashboard()
    assert len({panel["id"] for panel in document["panels"]}) == len(document["panels"])
    taken: set[tuple[int, int]] = set()
    for panel in document["panels"]:
        place = panel["gridPos"]
        cells = {(place["x"] + x, place["y"] + y) for x in range(place["w"]) for y in range(place["h"])}
        assert not cells & taken and place["x"] + place["w"] <= 24
        taken |= cells
    source = yaml.safe_load((COMPOSE / "grafana" / "datasource.yaml").read_text())["datasources"][0]
    assert {panel["datasource"]["uid"] for panel in document["panels"]} == {source["uid"]}


def test_services_find_each_other() -> None:
    services = yaml.safe_load((COMPOSE / "compose.yaml").read_text())["services"]
    source = yaml.safe_load((COMPOSE / "grafana" / "datasource.yaml").read_text())["datasources"][0]
    prometheus = yaml.safe_load((COMPOSE / "prometheus.yaml").read_text())
    (target,) = prometheus["scrape_configs"][0]["static_configs"][0]["targets"]
    host, port = target.split(":")
    assert host in services and f"--metrics-port={port}" in services[host]["command"]
    assert source["url"] == "http://prometheus:9090" and "prometheus" in services
    provider = yaml.safe_load((COMPOSE / "grafana" / "dashboards.yaml").read_text())["providers"][0]
    mounted = [volume.split(":")[1] for volume in services["grafana"]["volumes"]]
    assert f"{provider['options']['path']}/nmes.json" in mounted
    assert services["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"] in mounted
