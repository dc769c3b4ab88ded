// Addresses of other versions are relative to the root of this one, wherever the site is served; the menu takes them as
// relative to the page.
{
  const root = new URL(document.documentElement.dataset.content_root, location.href);
  new MutationObserver(() => {
    for (const link of document.querySelectorAll('.version-switcher__menu a[href^="../"]')) {
      link.setAttribute("href", new URL(link.getAttribute("href"), root));
    }
  }).observe(document.documentElement, { childList: true, subtree: true });
}
