// What the theme leaves out for keyboard and screen reader: a name for its chevrons, and a way into boxes that scroll.
(() => {
  const scrollers = 'table.table, table.indextable, div.math, mjx-container[display="true"], div.highlight pre, div.output pre, .cell_output table';
  function reach() {
    for (const box of document.querySelectorAll(scrollers)) {
      if (box.scrollWidth > box.clientWidth + 1 && getComputedStyle(box).overflowX !== 'visible') box.tabIndex = 0;
    }
  }
  addEventListener('load', async () => {
    document.querySelectorAll('summary:has(> .toctree-toggle)').forEach(summary => summary.setAttribute('aria-label', 'Sections'));
    reach();
    await window.MathJax?.startup?.promise;
    reach();
  });
  addEventListener('resize', reach);
})();
