"""What only the owner of a copied model knows, and a platform asks."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, HttpUrl, StringConstraints, UrlConstraints


def _without_password(url: HttpUrl) -> HttpUrl:
    if url.username or url.password:
        raise ValueError("leave user name and password out of the address")
    return url


# All of it goes into the line of one GET: at most 14 kB where every letter of the note takes nine, of the server's 16.
Url = Annotated[HttpUrl, UrlConstraints(max_length=400), AfterValidator(_without_password)]
Note = Annotated[str, StringConstraints(max_length=1000)]


class Told(BaseModel):
    """What only the owner knows. It is put into the pack as the owner's word, and kept nowhere."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    copy_url: list[Url] = Field([], max_length=10, description="Where the copy was found; give it once for each place.")
    original_url: Url | None = Field(None, description="Where the original is published.")
    note: Note = Field("", description="Your own words; set off from what was found.")
