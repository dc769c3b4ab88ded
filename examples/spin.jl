const library = joinpath(@__DIR__, "libcoadjoint.so")

check(code) = code == 0 || error(unsafe_string(ccall((:coadjoint_message, library), Cstring, ())))

table = read("top.json", String)
run = Ref{Ptr{Cvoid}}()
check(ccall((:coadjoint_create, library), Cint, (Cstring, Csize_t, Ref{Ptr{Cvoid}}), table, sizeof(table), run))
x = [0.3, 0.2, 1.0, 0.6, 0.0, 0.8]
check(ccall((:coadjoint_set_state, library), Cint, (Ptr{Cvoid}, Ptr{Cdouble}, Csize_t), run[], x, length(x)))
saved = Matrix{Float64}(undef, length(x), 10)
check(ccall((:coadjoint_save, library), Cint, (Ptr{Cvoid}, Int64, Int64, Ptr{Cdouble}, Csize_t),
            run[], 10, 100, saved, length(saved)))
println(saved[1, end], " ", saved[2, end])
ccall((:coadjoint_destroy, library), Cvoid, (Ptr{Cvoid},), run[])
