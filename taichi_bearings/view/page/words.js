"use strict";
// What the parts of the page of `bearings view` share: names, colours, and how numbers are written.

const SLIPLESS = 0, SLIPPING = 1, UNDECIDED = 2, DRIVEN = 3, TIED = 4;
const CUT = 1, PATH = 2;
const KINDS = [["bottom", "#0072b2"], ["top", "#d55e00"], ["both", "#cc79a7"], ["bottom and top, by component", "#e69f00"],
  ["one component only", "#56b4e9"], ["neither", "#a5abb3"]];
const PIECES = ["#009e73", "#0072b2", "#d55e00", "#e69f00", "#c9ced5"], SIDES = ["#0072b2", "#d55e00"];  // their names are in `facts`
const TELLING = ["#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9"];  // tell labels apart
const LOOK = { network: "#4b5a6b", cut: "#e69f00", walls: "#3c4653", path: "#009e73", undecided: "#cc79a7", plain: "#d5dae1",
  frame: "#c5ccd5", bottom: "#3b4cc0", top: "#b40426" };
const ACROSS = ["cut", "walls"], FLAT = { cut: 0.13, walls: 0.08, slipping: 0.13 };  // radii of lines across contacts in 2D
const SLIDERS = ["size", "power", "threshold", "time"];
const LAYERS = [["spheres", "spheres"], ["network", "slipless contacts"], ["slipping", "slipping contacts"],
  ["undecided", "tied and undecided contacts"], ["cut", "minimum cut"], ["walls", "domain boundaries"], ["path", "shortest path, its spins"],
  ["bottlenecks", "bottlenecks"]];
const COLOURS = [  // key, text, and the array that it needs
  ["spin", "spin", "spin"], ["turn", "how its domain turns", "turn"], ["domain", "rigid domain", "domain"],
  ["kind", "plane its domain turns with", "kind"], ["body", "driven body", "body"], ["piece", "piece of the slipless network", "spin"],
  ["betweenness", "share of shortest paths", "sphere_betweenness"], ["side", "side of the minimum cut", "above"], ["plain", "plain", "spin"],
];
const PRESETS = [  // name, layers, colour of spheres, their size in 3D, kinds of domains that are hidden in 3D, needed layer
  ["Spins", ["spheres"], "spin", 1, [], "spheres"],
  ["Network", ["network", "path"], "piece", 0.25, [], "network"],
  ["Slipping", ["slipping", "undecided"], "plain", 0.25, [], "slipping"],
  ["Minimum cut", ["cut"], "side", 0.25, [], "cut"],
  ["Domains", ["spheres", "walls"], "turn", 1, [0, 1], "domains"],
  ["Bottlenecks", ["bottlenecks", "path"], "betweenness", 0.25, [], "bottlenecks"],
];
const OVER = ["path", "bottlenecks"];  // layers that are drawn after the transparent ones
const OF_THE_END = { layers: ["walls", "path", "bottlenecks"], colours: ["turn", "domain", "kind", "betweenness"] };  // not known of snapshots
const MANY = 5000, FAINTEST = 0.16;  // layers with more contacts become transparent, down to this opacity
const SHARES = -4;  // decades of the betweenness that colours tell apart

const element = (id) => document.getElementById(id);
const grouped = (count) => count.toLocaleString("en-GB");
const six = (value) => {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? value.toExponential(5).replace(/\.?0+e/, "e") : String(Number(value.toPrecision(6)));
};
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
