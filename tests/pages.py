"""Pages in a browser: when they are drawn, and where their cursor is."""

from tests.waiting import PATIENCE


def ready(browser, episode="0"):
    """Wait until an episode is drawn."""
    from selenium.webdriver.support.ui import WebDriverWait

    script = "return document.documentElement.dataset.ready"
    WebDriverWait(browser, PATIENCE).until(lambda found: found.execute_script(script) == episode)


def now(browser):
    """What stands under the slider."""
    return browser.find_element("id", "now").text
