// Draws the markers' labels beside them, where they do not overlap.

const CELL_PX = 14;

export function drawLabels(ctx, motion, points, { colours, selected, options }) {
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  ctx.lineJoin = "round";
  ctx.lineWidth = 3;
  ctx.strokeStyle = colours.panel;
  const taken = new Set();
  const drawLabel = (slot, colour, mustShow) => {
    const [x, y, radius, seen] = points.subarray(4 * slot, 4 * slot + 4);
    if (seen === 0) return;
    const text = motion.labels[slot];
    const cells = [];
    for (let i = 0; i <= text.length * 7; i += CELL_PX) {
      cells.push(`${Math.round((x + i) / CELL_PX)},${Math.round(y / CELL_PX)}`);
    }
    if (!mustShow && cells.some((cell) => taken.has(cell))) return;
    cells.forEach((cell) => taken.add(cell));
    ctx.strokeText(text, x + radius + 5, y);
    ctx.fillStyle = colour;
    ctx.fillText(text, x + radius + 5, y);
  };
  if (selected >= 0) {
    ctx.font = "700 15px system-ui, sans-serif";
    drawLabel(selected, colours.selected, true);
  }
  ctx.font = "500 12px system-ui, sans-serif";
  for (let slot = 0; options.labels && slot < motion.n; slot += 1) {
    if (slot !== selected) drawLabel(slot, colours.text, false);
  }
}
