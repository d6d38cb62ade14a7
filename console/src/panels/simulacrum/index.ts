import { define } from "../../element.svelte.js";
import plot from "../../parts/plot.css?inline";
import "../token/index.js";
import Simulacrum from "./Simulacrum.svelte";
import css from "./simulacrum.css?inline";

define("mom-simulacrum", Simulacrum, plot + css, ["path"]);
