"""A claim and an asset by themselves: pictures beside the verdict, sharing, what can be copied, names of files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.service.web.conftest import PHONE, Served, shoot, sign_in
from tests.service.web.journey import PLANT
from tests.service.web.stock import ask, png, stock, upload
from tests.service.web.stubs import a_claim, lists

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

IN_3D = re.compile(r"/model\?format=compressed")
HAS = "[...document.querySelectorAll('.side-by-side img')].map((image) => image.naturalWidth)"


def claim_of(page: Page, served: Served) -> str:
    """Open the claim."""
    _, claim = stock(served)
    page.goto(f"{served.address}/#claim/{claim}")
    page.locator(".verdict").wait_for()
    return claim


def box(page: Page, name: str) -> Any:
    """Where an element is."""
    found = page.locator(name).bounding_box()
    assert found
    return found


def test_suspect_and_asset_stand_beside_the_verdict(page: Page, served: Served) -> None:
    asset, claim = stock(served)
    named = a_claim(1, id=claim, suspects=["stolen.ply", "b.ply", "c.ply"])
    queries = lists(page, claims=[named])
    claim_of(page, served)
    page.locator(".side-by-side img").nth(1).wait_for()
    assert min(page.evaluate(HAS)) > 300
    page.locator("figcaption", has_text="Your model, marked").get_by_text(PLANT.name).wait_for()
    page.locator("figcaption", has_text="Suspect").get_by_text("stolen.ply and 2 more").wait_for()
    assert page.get_by_text("examined", exact=True).is_hidden(), "it is named twice"
    verdict, pictures = box(page, ".verdict"), box(page, ".side-by-side")
    assert pictures["x"] > verdict["x"] + verdict["width"], "not beside it"
    assert [query["q"] for query in queries] == [[claim]]
    link = page.locator(".facts a")
    assert link.get_attribute("href") == f"#asset/{asset}"
    page.locator(".facts a", has_text=ask(served, f"/v1/assets/{asset}")["label"]).wait_for()
    page.set_viewport_size(PHONE)
    verdict, pictures = box(page, ".verdict"), box(page, ".side-by-side")
    assert pictures["y"] >= verdict["y"] + verdict["height"], "over it"


def test_a_claim_without_pictures_names_what_was_examined(page: Page, served: Served) -> None:
    """Nothing could be compared, or drawn: the file's name is all that tells one claim from another."""
    _, claim = stock(served)
    lists(page, claims=[a_claim(1, id=claim, suspects=["stolen.ply", "b.ply"])])

    def bare(route: Route) -> None:
        answer = route.fetch()
        plain = answer.json()
        plain["document"]["pictures"] = {}
        route.fulfill(response=answer, json=plain)

    page.route(f"**/v1/claims/{claim}", bare)
    claim_of(page, served)
    page.locator(".facts", has_text="stolen.ply and 1 more").wait_for()
    assert page.locator(".side-by-side").count() == 0


def test_pictures_are_added_to_a_check_that_was_short(page: Page, served: Served, tmp_path: Path) -> None:
    """The request has the pictures of before, as they were stored, and the further one."""
    asset, claim = stock(served)
    before = [upload(served, f"{n}.png", png(n)) for n in (1, 2)]
    digests = [hashlib.sha256(png(n)).hexdigest() for n in (1, 2)]
    further = tmp_path / "a further one.ply"  # a picture all the same
    further.write_bytes(png(3))
    asked: list[Any] = []

    def short(route: Route) -> None:
        answer = route.fetch()
        plain = answer.json()
        plain["document"] |= {"verdict": "inconclusive", "subject": {"kind": "pictures", "sha256": digests}}
        route.fulfill(response=answer, json=plain)

    def refuse(route: Route) -> None:
        asked.append(route.request.post_data_json)
        route.fulfill(status=409, json={"title": "stop here", "status": 409})

    page.route(f"**/v1/claims/{claim}", short)
    page.route("**/v1/verify", refuse)
    claim_of(page, served)
    shoot(page, "claim-short")
    page.get_by_label("Further pictures").set_input_files(further)
    page.get_by_role("button", name="Check all pictures together").click()
    page.locator("#check-problem", has_text="stop here").wait_for()
    (body,) = asked
    assert body["image_upload_ids"][:2] == before
    assert ask(served, f"/v1/uploads/{body['image_upload_ids'][2]}")["name"] == further.name
    assert body["asset_id"] == asset, "it was asked about this asset"
    for one in before:
        ask(served, f"/v1/uploads/{one}", "DELETE")
    page.goto(f"{served.address}/#claim/{claim}")
    page.get_by_label("Further pictures").set_input_files(further)
    page.get_by_role("button", name="Check all pictures together").click()
    page.get_by_text("The pictures of this check are gone").wait_for()


def test_a_claim_about_a_deleted_model_says_so(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    page.route(f"**/v1/assets/{asset}", lambda route: route.fulfill(status=404, json={"title": "gone", "status": 404}))
    claim_of(page, served)
    page.locator(".facts", has_text="deleted since").wait_for()
    assert page.locator(".facts a").count() == 0


class Shares:
    """What the service does with shared reports, in its place."""

    def __init__(self, page: Page, claim: str) -> None:
        self.made: list[dict[str, Any]] = []
        self.days: list[int] = []
        page.route(f"**/v1/claims/{claim}/share", self.make)
        page.route(f"**/v1/claims/{claim}/shares", lambda route: route.fulfill(json={"items": self.made}))
        page.route("**/v1/shares/*", self.revoke)

    def make(self, route: Route) -> None:
        self.days.append(route.request.post_data_json["days"])
        one = {"id": f"sh_{len(self.days)}", "expires_at": "2026-12-07T10:00:00+00:00"}
        self.made.insert(0, one)
        route.fulfill(status=201, json={**one, "url": f"/shared/secret{len(self.days)}"})

    def revoke(self, route: Route) -> None:
        assert route.request.method == "DELETE"
        self.made = [one for one in self.made if one["id"] != route.request.url.rsplit("/", 1)[1]]
        route.fulfill(status=204)


def test_a_report_is_shared_and_no_longer(page: Page, served: Served) -> None:
    _, claim = stock(served)
    shares = Shares(page, claim)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    claim_of(page, served)
    page.get_by_text("Share the report").click()
    page.get_by_label("Valid for").select_option("30 days")
    page.get_by_role("button", name="Create a link").click()
    address = page.get_by_label("Link to the report")
    address.wait_for()
    assert address.input_value() == f"{served.address}/shared/secret1"
    assert shares.days == [30]
    assert "7 Dec 2026" in page.locator(".shares li").inner_text()
    shoot(page, "claim-share")
    page.get_by_role("button", name="Copy the link").click()
    page.get_by_text("Copied", exact=True).wait_for()
    assert page.evaluate("navigator.clipboard.readText()") == f"{served.address}/shared/secret1"
    page.get_by_role("button", name="Revoke").click()
    page.locator(".shares:empty").wait_for(state="attached")
    assert shares.made == []
    assert address.count() == 0, "a dead address is still shown"


def test_a_claim_can_be_on_the_page_twice(page: Page) -> None:
    ids = page.evaluate(
        """async () => {
          const { packForm } = await import("/static/js/pack.js");
          const { shareForm } = await import("/static/js/share.js");
          const claim = { claim_id: "cl_1", verdict: "marked" };
          const all = [packForm(claim, {}), packForm(claim, {}), shareForm(claim).element, shareForm(claim).element];
          return all.flatMap((form) => [...form.querySelectorAll("[id]")].map((element) => element.id));
        }"""
    )
    assert len(ids) == len(set(ids)) == 10


@pytest.mark.parametrize("status", [404, 403])
def test_nothing_is_offered_to_share_where_that_cannot_be(page: Page, served: Served, status: int) -> None:
    _, claim = stock(served)
    page.route(
        f"**/v1/claims/{claim}/shares",
        lambda route: route.fulfill(status=status, json={"title": "no", "status": status}),
    )
    with page.expect_response(f"**/v1/claims/{claim}/shares"):
        claim_of(page, served)
    page.locator(".side-by-side img").nth(1).wait_for()
    assert page.get_by_text("Share the report").is_hidden()
    assert page.get_by_role("alert").count() == 0


def test_ids_and_digests_are_copied_whole(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    plain = ask(served, f"/v1/assets/{asset}")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.route(IN_3D, lambda route: route.abort())  # drawing is no part of this, and takes long
    page.goto(f"{served.address}/#asset/{asset}")
    named = {
        "asset id": asset,
        "record id": plain["record_id"],
        "owner key id": plain["owner_key_id"],
        "SHA-256 of the original": plain["original_sha256"],
        "SHA-256 of the marked model": plain["model_sha256"],
    }
    for what, text in named.items():
        page.get_by_role("button", name=f"Copy {what}").click()
        page.locator("#said", has_text=f"Copied: {what}").wait_for(state="attached")
        assert page.evaluate("navigator.clipboard.readText()") == text
    claim = claim_of(page, served)
    digest = ask(served, f"/v1/claims/{claim}")["document"]["subject"]["sha256"][0]
    for what, text in {"claim id": claim, "SHA-256 of the suspect": digest}.items():
        page.get_by_role("button", name=f"Copy {what}").click()
        page.locator("#said", has_text=f"Copied: {what}").wait_for(state="attached")
        assert page.evaluate("navigator.clipboard.readText()") == text


def test_copying_works_without_tls_and_by_keyboard(browser: Browser, served: Served) -> None:
    asset, _ = stock(served)
    page = browser.new_page()
    page.add_init_script("Object.defineProperty(navigator, 'clipboard', { value: undefined })")
    page.route(IN_3D, lambda route: route.abort())
    page.goto(f"{served.address}/#asset/{asset}")
    sign_in(page, served.api_key)
    page.get_by_role("button", name="Copy asset id").focus()
    page.keyboard.press("Enter")
    page.get_by_text("Copied", exact=True).wait_for()
    assert "Copied" in page.evaluate("document.activeElement.textContent"), "the focus is gone"
    page.goto(f"{served.address}/#library")
    page.get_by_label("Find", exact=True).focus()
    page.keyboard.press("Control+V")
    assert page.get_by_label("Find", exact=True).input_value() == asset
    page.close()


def test_a_file_is_called_as_the_model_without_a_second_ending(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    page.route(IN_3D, lambda route: route.abort())
    page.goto(f"{served.address}/#asset/{asset}")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the marked model").click()
    assert download.value.suggested_filename == "plant-marked.splat"
    stems = """async (labels) => {
      const { fileStem } = await import("/static/js/words.js");
      return labels.map((label) => fileStem({ label, id: "as_1" }));
    }"""
    names = {
        "plant.splat": "plant",
        "scan.compressed.ply": "scan",
        "Two words.PLY": "Two-words",
        "v1.2 final": "v1.2-final",
        "花瓶.ply": "花瓶",
        "../../etc/passwd": "etc-passwd",
        ".splat": "as_1",
        "": "as_1",
        "🪴" * 3: "as_1",
        "ä" * 200: "ä" * 80,
    }
    assert dict(zip(names, page.evaluate(stems, list(names)), strict=True)) == names


def test_what_marking_found_is_said_beside_the_model(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    said = """async ([asset, made]) => {
      const { assetView } = await import("/static/js/asset.js");
      return assetView(asset, { title: "Marked", made }).element.textContent;
    }"""
    plain = ask(served, f"/v1/assets/{asset}")
    found = page.evaluate(said, [plain, {"already_carries": ["as_1"], "not_screened": 3}])
    assert "already carried one of your watermarks" in found
    assert "3 were not checked" in found
    found = page.evaluate(said, [plain, {"already_carries": [], "not_screened": 0}])
    assert "already carried" not in found
    assert "looked for" not in found
    assert "alone" not in found
    plain["report"] |= {"psnr_worst_view": 47.2, "psnr_total_worst_view": 36.9}
    found = page.evaluate(said, [plain, {}])
    assert "47.2 dBPSNR of the watermark alone" in found
    assert "36.9 dBPSNR with pruning" in found


def test_an_asset_says_what_auto_chose_and_what_it_saved(page: Page, served: Served) -> None:
    asset, _ = stock(served)
    shown = ask(served, f"/v1/assets/{asset}")
    choice = {
        "psnr_db": 46.0,
        "views": 6,
        "predicted_z": 17.21,
        "wanted_z": 15.4,
        "saved_bytes": 0,
        "saved_seconds": 1.04,
    }
    shown["report"]["choice"] = choice
    page.route(f"**/v1/assets/{asset}", lambda route: route.fulfill(json=shown))
    page.goto(f"{served.address}/#asset/{asset}")
    said = page.get_by_text("Auto chose")
    assert said.inner_text() == (
        "Auto chose 6 views and 46 dB: a poor picture should show z 17.2, and 15.4 is needed."
        " This took about 1.0 s less than Balanced would, by an estimate."
    )
    shoot(page, "asset-auto")
    choice |= {"wanted_z": 0.0, "saved_bytes": 1_240_000, "saved_seconds": None}
    page.reload()
    assert said.inner_text() == (
        "Auto chose 6 views and 46 dB: no picture was tried. The file is 1.2 MB smaller than the whole model's."
    )
