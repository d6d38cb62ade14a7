import { define } from "../../element.svelte.js";
import Tree from "./Tree.svelte";
import css from "./tree.css?inline";

define("mom-tree", Tree, css, ["path", "selected"]);
