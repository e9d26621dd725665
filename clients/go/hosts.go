package nmes

import (
	"context"
	"fmt"
)

// mostWorlds is how many worlds a host may list: it may have 10,000 unless it was told otherwise.
const mostWorlds = 1_000_000

// NewWorld is a world to be created. Only its name is needed.
type NewWorld struct {
	// Its name, which no other world of the host has.
	World string `json:"world"`
	// The template that its config is taken from; what the host was started with if empty.
	Template string `json:"template,omitempty"`
	// The seed of all that it draws; nil for that of the template.
	Seed *int `json:"seed,omitempty"`
}

// question is an auth that enters no world: the server answers with a list, and hangs up.
type question struct {
	Password string    `json:"password"`
	List     bool      `json:"list,omitempty"`
	Start    int       `json:"start,omitempty"`
	Create   *NewWorld `json:"create,omitempty"`
	Close    string    `json:"close,omitempty"`
}

// Worlds returns the worlds of a host that the password opens; it enters none. Of the options those of the world and of
// who enters it do not matter.
//
// Errors are those of Dial, and unsupported of a server that has no such list.
func Worlds(ctx context.Context, address string, options Options) ([]WorldListWorlds, error) {
	var worlds []WorldListWorlds
	for start := 0; ; {
		list, err := ask(ctx, address, options, question{List: true, Start: start})
		if err != nil {
			return nil, err
		}
		if worlds = append(worlds, list.Worlds...); list.Next == nil {
			return worlds, nil
		}
		if *list.Next <= start || len(worlds) > mostWorlds {
			return nil, &Disconnected{"bad_reply", "the list of worlds has no end"}
		}
		start = *list.Next
	}
}

// CreateWorld has a host create a world, and returns what is told of it; it does not enter it. The password must be the
// host's own, or that of a maker, which then opens this world too.
//
// A *CommandError is auth_failed, limit_reached, template_not_found, world_exists, world_unavailable, host_draining, or
// unsupported.
func CreateWorld(ctx context.Context, address string, options Options, world NewWorld) (*WorldListWorlds, error) {
	list, err := ask(ctx, address, options, question{Create: &world})
	if err != nil {
		return nil, err
	}
	if len(list.Worlds) != 1 {
		return nil, &Disconnected{"bad_reply", fmt.Sprintf("of a new world %d are told", len(list.Worlds))}
	}
	return &list.Worlds[0], nil
}

// CloseWorld closes a world of a host for good: its clients are told world_closed, and its recording ends whole. The
// password must be the host's own, or that of the maker who created it.
func CloseWorld(ctx context.Context, address string, options Options, world string) error {
	_, err := ask(ctx, address, options, question{Close: world})
	return err
}

func ask(ctx context.Context, address string, options Options, asked question) (*WorldList, error) {
	var err error
	if asked.Password, err = options.password(); err != nil {
		return nil, err
	}
	connection, err := open(ctx, address, options.TLS)
	if err != nil {
		return nil, err
	}
	defer connection.close()
	list, err := wait[struct {
		Type string `json:"type"`
		WorldList
	}](ctx, connection.authenticate(asked))
	if err != nil {
		return nil, err
	}
	if list.Type != "world_list" {
		return nil, &CommandError{Code: "unsupported", Message: "this server cannot list, create or close worlds"}
	}
	return &list.WorldList, nil
}
