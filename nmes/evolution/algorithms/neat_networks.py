"""Networks as NEAT sees them: genes that two networks have in common by the names of nodes, and how these vary.

After K. O. Stanley and R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies", Evolutionary
Computation 10 (2002). Hides how a brain of kind `graph` becomes genes and again a brain. A gene is known by what it
joins: where NEAT counts innovations, a node that splits a link is named after the link, so the same step in two lines
of descent is the same gene. NEAT keeps a split link as a disabled gene; here it is gone, and counts as what both have
where the other network has the node that split it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from nmes.backend.rotation import total
from nmes.schemas.documents import JsonObject
from nmes.variation.brain_changes import splitting_node
from nmes.variation.draw import Draw

__all__ = ["Gene", "Network", "add_link", "cross_networks", "distance", "perturb", "split_link"]

Gene = tuple[str, str, str]
"""What a number of a network is: `from` a node or `sensor` (or `bias`), which one (or nothing), and the node that
it goes to."""
_FEW = 20  # genes; of smaller networks differences are not measured by their size
_MOST = 1_000.0  # the greatest weight


@dataclass(frozen=True)
class Network:
    """A network.

    Attributes:
        nodes: What else the document says of each node, by its id: `motor`, `activation`.
        genes: Biases of nodes and weights of links.
    """

    nodes: Mapping[str, JsonObject]
    genes: Mapping[Gene, float]

    @classmethod
    def of(cls, document: JsonObject) -> Network:
        """Returns the network of a good brain of kind `graph`; of parallel links the last counts."""
        rest = [
            {name: value for name, value in node.items() if name not in ("id", "bias")} for node in document["nodes"]
        ]
        nodes = {node["id"]: others for node, others in zip(document["nodes"], rest, strict=True)}
        genes: dict[Gene, float] = {("bias", "", node["id"]): node.get("bias", 0.0) for node in document["nodes"]}
        for link in document.get("links", ()):
            end = "from" if "from" in link else "sensor"
            genes[end, link[end], link["to"]] = link.get("weight", 1.0)
        return cls(nodes, genes)

    @property
    def document(self) -> JsonObject:
        """The brain of kind `graph`."""
        nodes = [{"id": node, **rest, "bias": self.genes["bias", "", node]} for node, rest in self.nodes.items()]
        links = [{end: source, "to": to, "weight": self.genes[end, source, to]} for end, source, to in self.links]
        return {"kind": "graph", "nodes": nodes, "links": links}

    @property
    def links(self) -> Iterator[Gene]:
        """The genes that are links."""
        return (gene for gene in self.genes if gene[0] != "bias")

    @property
    def hidden(self) -> list[str]:
        """The nodes that drive no motor."""
        return [node for node, rest in self.nodes.items() if "motor" not in rest]


def _splitting(link: Gene) -> str:
    """Returns the name of the node that splits a link."""
    end, source, to = link
    return splitting_node({end: source}, to)


def perturb(network: Network, draw: Draw, step: float, anew: float) -> Network:
    """Returns a network with other numbers: each is shifted by at most a step, or drawn anew up to as far from 0.

    Args:
        network: The network.
        draw: All choices.
        step: How far.
        anew: Which part of the numbers is drawn anew.
    """
    genes = {
        gene: _bounded((0.0 if draw.chance(anew) else value) + draw.uniform(-step, step))
        for gene, value in network.genes.items()
    }
    return replace(network, genes=genes)


def _bounded(weight: float) -> float:
    return round(min(max(weight, -_MOST), _MOST), 6)


def add_link(network: Network, sensors: Sequence[str], draw: Draw, step: float, recurrent: bool) -> Network | None:
    """Returns a network with one more link, or None where no place for one is found.

    Args:
        network: The network.
        sensors: The names of the body's sensors.
        draw: All choices.
        step: The new weight is at most as far from 0.
        recurrent: Whether a link may close a loop.
    """
    sources = [("sensor", sensor) for sensor in sensors] + [("from", node) for node in network.nodes]
    for _ in range(20):
        gene = (*draw.one_of(sources), draw.one_of(tuple(network.nodes)))
        loop = gene[0] == "from" and not recurrent and gene[1] in _reached(network, gene[2])
        if gene not in network.genes and not loop:
            return replace(network, genes={**network.genes, gene: _bounded(draw.uniform(-step, step))})
    return None


def _reached(network: Network, node: str) -> set[str]:
    """Returns the nodes to which a node's value goes, itself among them."""
    reached, waiting = {node}, [node]
    while waiting:
        source = waiting.pop()
        new = {to for end, other, to in network.links if end == "from" and other == source} - reached
        reached |= new
        waiting += sorted(new)
    return reached


def split_link(network: Network, draw: Draw, activation: str) -> Network | None:
    """Returns a network with a node in a link, 1 on the way in and the old weight on the way out; or None."""
    links = [link for link in network.links if _splitting(link) not in network.nodes]
    if not links:
        return None
    link = draw.one_of(links)
    end, source, to = link
    node = _splitting(link)
    genes = {gene: value for gene, value in network.genes.items() if gene != link}
    genes |= {("bias", "", node): 0.0, (end, source, node): 1.0, ("from", node, to): network.genes[link]}
    return Network({**network.nodes, node: {"activation": activation}}, genes)


def cross_networks(fitter: Network, other: Network, draw: Draw) -> Network:
    """Returns a child that is built as the fitter parent, and has each number that both have from either."""
    genes = {
        gene: other.genes[gene] if gene in other.genes and draw.chance(0.5) else value
        for gene, value in fitter.genes.items()
    }
    return replace(fitter, genes=genes)


def distance(one: Network, other: Network, weights: float) -> float:
    """Returns the compatibility distance: links that only one has, and how far the numbers of both are apart.

    Args:
        one: A network.
        other: Another.
        weights: The coefficient of the mean difference of numbers, c3; those of links, c1 and c2, are 1.
    """
    both = one.genes.keys() & other.genes.keys()
    apart = [link for link in one.links if link not in both and _splitting(link) not in other.nodes]
    apart += [link for link in other.links if link not in both and _splitting(link) not in one.nodes]
    size = max(len(one.genes), len(other.genes))
    mean = total(sorted(abs(one.genes[gene] - other.genes[gene]) for gene in both)) / max(len(both), 1)
    return len(apart) / (1 if size < _FEW else size) + weights * mean
