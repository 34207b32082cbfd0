"use strict";
// What the parts of the page of `bearings view` share: names, colours, and how numbers are written.
// Contacts along x come first, then y (, z), each in C order of their lower spheres, as in taichi_bearings.

const SLIPLESS = 0, SLIPPING = 1, UNDECIDED = 2, DRIVEN = 3;
const CUT = 1, PATH = 2;
const KINDS = [["bottom", "#0072b2"], ["top", "#d55e00"], ["both", "#cc79a7"], ["bottom and top, by component", "#e69f00"],
  ["one component only", "#56b4e9"], ["neither", "#a5abb3"]];
const PIECES = [["joined to bottom and top", "#009e73"], ["joined to the bottom", "#0072b2"], ["joined to the top", "#d55e00"],
  ["an island", "#e69f00"], ["touches no slipless contact", "#c9ced5"]];
const SIDES = [["below the cut", "#0072b2"], ["above the cut", "#d55e00"]];
const LOOK = { network: "#4b5a6b", cut: "#e69f00", walls: "#3c4653", path: "#009e73", undecided: "#cc79a7", plain: "#d5dae1",
  frame: "#c5ccd5", bottom: "#3b4cc0", top: "#b40426" };
const ACROSS = ["cut", "walls"], FLAT = { cut: 0.13, walls: 0.08, slipping: 0.13 };  // radii of lines across contacts in 2D
const LAYERS = [["spheres", "spheres"], ["network", "slipless contacts"], ["slipping", "slipping contacts"],
  ["undecided", "undecided contacts"], ["cut", "minimum cut"], ["walls", "domain boundaries"], ["path", "shortest path, its spins"],
  ["bottlenecks", "bottlenecks"]];
const COLOURS = [["spin", "spin |ω| / ω max"], ["turn", "how its domain turns"], ["kind", "what its domain is locked to"],
  ["piece", "piece of the slipless network"], ["betweenness", "share of shortest paths"], ["side", "side of the minimum cut"], ["plain", "plain"]];
const PRESETS = [  // name, layers, colour of the spheres, their size in 3D, kinds of domains that are hidden there, needed layer
  ["Spins", ["spheres"], "spin", 1, [], "spheres"],
  ["Network", ["network", "path"], "piece", 0.25, [], "network"],
  ["Slipping", ["slipping", "undecided"], "plain", 0.25, [], "slipping"],
  ["Minimum cut", ["cut"], "side", 0.25, [], "cut"],
  ["Domains", ["spheres", "walls"], "turn", 1, [0, 1], "spheres"],
  ["Bottlenecks", ["bottlenecks", "path"], "betweenness", 0.25, [], "bottlenecks"],
];
const OVER = ["path", "bottlenecks"];  // drawn after what one sees through
const MANY = 5000;  // contacts beyond which a layer hides what is behind it, if nothing is done about that
const SHARES = -4;  // decades of the betweenness that colours tell apart

const element = (id) => document.getElementById(id);
const grouped = (count) => count.toLocaleString("en-GB");
const six = (value) => {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? value.toExponential(5).replace(/\.?0+e/, "e") : String(Number(value.toPrecision(6)));
};
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
